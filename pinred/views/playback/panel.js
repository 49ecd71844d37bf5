// The shape panel: the path of two joints over the curvature of the connection.
"use strict";
function shapePanel(panel, array, mix, canvas, picker, redraw) {
  const pen = canvas.getContext("2d"), box = [64, 46, 436, 372]; // left, top, width, height
  const path = array(panel.path), field = array(panel.field);
  const across = (v, i) => (v - panel.low[i]) / (panel.high[i] - panel.low[i]);
  const px = (a) => box[0] + box[2] * across(a, 0), py = (b) => box[1] + box[3] * (1 - across(b, 1));
  let backdrop = null;
  function colour(v) { // −1 blue, 0 white, 1 orange: told apart by the colour-blind
    const strong = v < 0 ? [33, 102, 172] : [217, 95, 2], a = Math.min(1, Math.abs(v));
    return strong.map((c) => 255 + (c - 255) * a);
  }
  function paintField(ink, c) {
    const n = panel.fine, values = field.subarray(c * n * n, (c + 1) * n * n);
    const most = Math.max(1e-300, values.reduce((m, v) => Math.max(m, Math.abs(v)), 0));
    const image = ink.createImageData(n, n);
    values.forEach((v, at) => {
      const a = Math.floor(at / n), b = at % n, to = 4 * ((n - 1 - b) * n + a);
      image.data.set([...colour(v / most), 255], to);
    });
    const small = document.createElement("canvas");
    small.width = small.height = n;
    small.getContext("2d").putImageData(image, 0, 0);
    ink.drawImage(small, ...box);
    paintBar(ink, most, panel.components[c].replace(/ \[.*/, ""));
  }
  function paintBar(ink, most, name) { // colour bar above the field
    const bound = most < 1e-3 ? most.toExponential(1) : most.toPrecision(2), top = 14, wide = 110;
    const left = box[0] + ink.measureText(`−${bound}`).width + 8;
    ink.fillStyle = "#1d2733";
    ink.fillText(`−${bound}`, box[0], top + 16);
    ink.fillText(`+${bound}`, left + wide + 8, top + 16);
    ink.textAlign = "right";
    ink.fillText(name, box[0] + box[2], top + 16);
    for (let x = 0; x < wide; x++) {
      ink.fillStyle = `rgb(${colour(2 * x / (wide - 1) - 1).map(Math.round)})`;
      ink.fillRect(left + x, top, 1, 20);
    }
    ink.strokeStyle = ink.fillStyle = "#1d2733";
    ink.strokeRect(left, top, wide, 20);
    ink.textAlign = "center";
    ink.fillText("0", left + wide / 2, top + 17);
  }
  function paintBackdrop() {
    const layer = document.createElement("canvas");
    [layer.width, layer.height] = [canvas.width, canvas.height];
    const ink = layer.getContext("2d");
    ink.font = "20px system-ui, sans-serif";
    if (panel.fine) paintField(ink, Number(picker.value || 0));
    ink.strokeStyle = "#1d2733";
    ink.strokeRect(...box);
    ink.beginPath();
    for (let i = 0; i < path.length; i += 2) ink.lineTo(px(path[i]), py(path[i + 1]));
    ink.lineWidth = 2;
    ink.strokeStyle = "rgba(20, 30, 40, .45)";
    ink.stroke();
    ink.fillStyle = "#1d2733";
    ink.textAlign = "center";
    ink.fillText(panel.labels[0], box[0] + box[2] / 2, 466);
    const tick = (v) => String(Number(v.toPrecision(2)));
    ink.textAlign = "left"; ink.fillText(tick(panel.low[0]), box[0], 442);
    ink.textAlign = "right"; ink.fillText(tick(panel.high[0]), box[0] + box[2], 442);
    ink.fillText(tick(panel.low[1]), box[0] - 6, box[1] + box[3]);
    ink.fillText(tick(panel.high[1]), box[0] - 6, box[1] + 16);
    ink.translate(22, box[1] + box[3] / 2);
    ink.rotate(-Math.PI / 2);
    ink.textAlign = "center"; ink.fillText(panel.labels[1], 0, 0);
    backdrop = layer;
  }
  panel.components.forEach((name, i) => picker.add(new Option(`curvature: ${name}`, String(i))));
  picker.hidden = !panel.components.length;
  picker.title = "the other joints are frozen at their initial values";
  picker.onchange = () => { paintBackdrop(); redraw(); };
  paintBackdrop();
  return (k, s) => { // draws the path up to fraction s of the way from frame k to the next
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(backdrop, 0, 0);
    pen.beginPath();
    for (let i = 0; i <= k; i++) pen.lineTo(px(path[2 * i]), py(path[2 * i + 1]));
    const [a, b] = mix(path, 2, k, s);
    pen.lineTo(px(a), py(b));
    pen.lineWidth = 3;
    pen.strokeStyle = "#111";
    pen.stroke();
    pen.beginPath();
    pen.arc(px(a), py(b), 9, 0, 2 * Math.PI);
    pen.fillStyle = "#f0e442";
    pen.fill();
    pen.stroke();
  };
}
