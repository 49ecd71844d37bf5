// The curvature of a connection over two joints, in colours, with its colour bar and axes.
"use strict";
function shapePlane(box, labels, look) { // box: left, top, width, height in the canvas
  const OUTSIDE = [176, 184, 192, 255]; // of values that are not defined
  const strong = look.field.map((text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16)));
  function colour(v) { // −1 blue, 0 white, 1 orange: told apart by the colour-blind
    const a = Math.min(1, Math.abs(v));
    return strong[v < 0 ? 0 : 1].map((c) => 255 + (c - 255) * a);
  }
  function paintField(ink, n, values, name) {
    const most = Math.max(1e-300, values.reduce((m, v) => (Math.abs(v) > m ? Math.abs(v) : m), 0));
    const image = ink.createImageData(n, n);
    values.forEach((v, at) => {
      const a = Math.floor(at / n), b = at % n, to = 4 * ((n - 1 - b) * n + a);
      image.data.set(Number.isNaN(v) ? OUTSIDE : [...colour(v / most), 255], to);
    });
    const small = document.createElement("canvas");
    small.width = small.height = n;
    small.getContext("2d").putImageData(image, 0, 0);
    ink.drawImage(small, ...box);
    paintBar(ink, most, name.replace(/ \[.*/, ""));
  }
  function paintBar(ink, most, name) { // colour bar above the field
    const bound = most < 1e-3 ? most.toExponential(1) : most.toPrecision(2), top = 14, wide = 110;
    const left = Math.ceil(box[0] + ink.measureText(`−${bound}`).width + 8); // whole pixels keep colours pure
    ink.fillStyle = look.ink;
    ink.fillText(`−${bound}`, box[0], top + 16);
    ink.fillText(`+${bound}`, left + wide + 8, top + 16);
    ink.textAlign = "right";
    ink.fillText(name, box[0] + box[2], top + 16);
    for (let x = 0; x < wide; x++) {
      ink.fillStyle = `rgb(${colour(2 * x / (wide - 1) - 1).map(Math.round)})`;
      ink.fillRect(left + x, top, 1, 20);
    }
    ink.strokeStyle = ink.fillStyle = look.ink;
    ink.strokeRect(left, top, wide, 20);
    ink.textAlign = "center";
    ink.fillText("0", left + wide / 2, top + 17);
  }
  function paintAxes(ink, low, high) {
    const tick = (v) => String(Number(v.toPrecision(2)));
    ink.save();
    ink.lineWidth = 1;
    ink.fillStyle = ink.strokeStyle = look.ink;
    ink.strokeRect(...box);
    ink.textAlign = "center";
    ink.fillText(labels[0], box[0] + box[2] / 2, box[1] + box[3] + 48);
    ink.textAlign = "left"; ink.fillText(tick(low[0]), box[0], box[1] + box[3] + 24);
    ink.textAlign = "right"; ink.fillText(tick(high[0]), box[0] + box[2], box[1] + box[3] + 24);
    ink.fillText(tick(low[1]), box[0] - 6, box[1] + box[3]);
    ink.fillText(tick(high[1]), box[0] - 6, box[1] + 16);
    ink.translate(22, box[1] + box[3] / 2);
    ink.rotate(-Math.PI / 2);
    ink.textAlign = "center"; ink.fillText(labels[1], 0, 0);
    ink.restore();
  }
  return { paintField, paintAxes };
}
