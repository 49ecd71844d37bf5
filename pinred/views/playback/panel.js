// The shape panel: the path of two joints over the curvature of the connection.
"use strict";
function shapePanel(panel, look, array, mix, canvas, picker, redraw) {
  const pen = canvas.getContext("2d"), box = [64, 46, 436, 372]; // left, top, width, height
  const path = array(panel.path), field = array(panel.field);
  const low = array(panel.low), high = array(panel.high);
  const across = (v, i) => (v - low[i]) / (high[i] - low[i]);
  const px = (a) => box[0] + box[2] * across(a, 0), py = (b) => box[1] + box[3] * (1 - across(b, 1));
  const plane = shapePlane(box, panel.labels, look);
  let backdrop = null;
  function paintBackdrop() {
    const layer = document.createElement("canvas");
    [layer.width, layer.height] = [canvas.width, canvas.height];
    const ink = layer.getContext("2d");
    ink.font = "20px system-ui, sans-serif";
    if (panel.fine) {
      const n = panel.fine, c = Number(picker.value || 0);
      plane.paintField(ink, n, field.subarray(c * n * n, (c + 1) * n * n), panel.components[c]);
    }
    plane.paintAxes(ink, low, high);
    ink.beginPath();
    for (let i = 0; i < path.length; i += 2) ink.lineTo(px(path[i]), py(path[i + 1]));
    ink.lineWidth = 2;
    ink.strokeStyle = "rgba(20, 30, 40, .45)";
    ink.stroke();
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
    pen.strokeStyle = look.mass[0];
    pen.stroke();
    pen.beginPath();
    pen.arc(px(a), py(b), 9, 0, 2 * Math.PI);
    pen.fillStyle = look.point;
    pen.fill();
    pen.stroke();
  };
}
