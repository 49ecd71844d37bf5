// The shape plane: the curvature over two joints, the current shape, and a loop drawn by hand.
"use strict";
const FINE = 41; // grid points of the picture along each axis; the base turns by the exact connection
function feelPlane(head, curvature, shapes, canvas, events) {
  const pen = canvas.getContext("2d"), box = [90, 46, 510, 510]; // left, top, width, height
  const d = head.labels.length, m = head.size, r = head.components.length;
  let pair = head.pair.slice(), low = [0, 0], high = [0, 0], backdrop = null, drawn = null, values = null;
  const toPixel = (p) => [box[0] + box[2] * (p[0] - low[0]) / (high[0] - low[0]),
    box[1] + box[3] * (1 - (p[1] - low[1]) / (high[1] - low[1]))];
  const within = (p) => p.map((v, k) => Math.min(high[k], Math.max(low[k], v)));
  function toShape(event) {
    const frame = canvas.getBoundingClientRect();
    const x = (event.clientX - frame.left) * canvas.width / frame.width;
    const y = (event.clientY - frame.top) * canvas.height / frame.height;
    return within([low[0] + (x - box[0]) / box[2] * (high[0] - low[0]),
      low[1] + (1 - (y - box[1]) / box[3]) * (high[1] - low[1])]);
  }
  function sample(u) { // B(e_a, e_b) over the plane, (r, FINE, FINE); NaN where the loops do not close
    const y = new Float64Array(3 * m), out = new Float64Array(r), kept = shapes.state;
    const field = Array.from({ length: r }, () => new Float64Array(FINE * FINE).fill(NaN));
    const [first, second] = pair.map((joint) => Array.from({ length: d }, (_, k) => Number(k === joint)));
    const cell = pair.map((joint, k) => Math.round((u[joint] - low[k]) / (high[k] - low[k]) * (FINE - 1)));
    const done = new Uint8Array(FINE * FINE), queue = [[...cell, kept]], point = Array.from(u);
    for (let k = 0; k < queue.length; k++) { // from the present shape to its neighbours, and so on
      const [a, b, from] = queue[k];
      if (a < 0 || b < 0 || a >= FINE || b >= FINE || done[a * FINE + b]) continue;
      point[pair[0]] = low[0] + a / (FINE - 1) * (high[0] - low[0]);
      point[pair[1]] = low[1] + b / (FINE - 1) * (high[1] - low[1]);
      shapes.state = from;
      try {
        const [w, along] = shapes.rates(point, first);
        y.set(w); y.set(along, m); y.set(shapes.rates(point, second)[1], 2 * m);
      } catch (error) { if (error instanceof OutOfReach) continue; throw error; }
      curvature(y, out);
      field.forEach((part, c) => { part[a * FINE + b] = out[c]; });
      done[a * FINE + b] = 1;
      for (const [i, j] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) queue.push([a + i, b + j, shapes.state]);
    }
    shapes.state = kept;
    return field;
  }
  const strength = (part) => part.reduce((most, v) => (Math.abs(v) > most ? Math.abs(v) : most), 0);
  function strongest(field) { // rotations have precedence
    const from = head.linear < r ? head.linear : 0;
    let best = from;
    for (let c = from; c < r; c++) if (strength(field[c]) > strength(field[best])) best = c;
    return best;
  }
  // Returns the centre of the box of half widths `half` with the largest integral of the field; null if
  // the loops do not close in any box.
  function centre(part, half) {
    const reach = half.map((h, k) => Math.round(h / (high[k] - low[k]) * (FINE - 1)));
    const middle = (FINE - 1) / 2, stride = part.some(Number.isNaN) ? 1 : 2;
    const flat = 1e-9 * strength(part) * (2 * reach[0] + 1) * (2 * reach[1] + 1) + 1e-300;
    let best = null, most = -1;
    for (let a = reach[0]; a < FINE - reach[0]; a += stride) for (let b = reach[1]; b < FINE - reach[1]; b += stride) {
      let sum = 0;
      for (let i = -reach[0]; i <= reach[0]; i++)
        for (let j = -reach[1]; j <= reach[1]; j++) sum += part[(a + i) * FINE + b + j];
      const worth = Math.max(flat, Math.abs(sum)) * (1 - 0.001 * Math.hypot(a - middle, b - middle));
      if (worth > most) { most = worth; best = [a, b]; } // not if the sum is NaN
    }
    return best && best.map((v, k) => low[k] + v / (FINE - 1) * (high[k] - low[k]));
  }
  function paint(component) {
    const layer = document.createElement("canvas");
    [layer.width, layer.height] = [canvas.width, canvas.height];
    const ink = layer.getContext("2d"), axes = shapePlane(box, pair.map((k) => head.labels[k]), head.look);
    ink.font = "22px system-ui, sans-serif";
    const part = values[component];
    const flat = strength(part) <= 1e-12 * Math.max(1e-3, ...values.map(strength));
    axes.paintField(ink, FINE, flat ? part.map((v) => 0 * v) : part, head.components[component]);
    axes.paintAxes(ink, low, high);
    backdrop = layer;
  }
  function frame(choice, w, component) { // shows two joints; returns the component
    pair = choice.slice();
    [low, high] = [pair.map((k) => head.low[k]), pair.map((k) => head.high[k])];
    values = sample(w);
    const shown = component ?? strongest(values);
    paint(shown);
    return shown;
  }
  function stroke(points, colour, width, dashes = []) {
    pen.beginPath();
    points.forEach((p) => pen.lineTo(...toPixel(p)));
    pen.setLineDash(dashes);
    [pen.strokeStyle, pen.lineWidth] = [colour, width];
    pen.stroke();
    pen.setLineDash([]);
  }
  function draw(w, loop) {
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(backdrop, 0, 0);
    if (loop) stroke(loop, head.look.mass[0], 4);
    const here = pair.map((k) => w[k]);
    if (drawn) {
      stroke([...drawn, here], head.look.mass[0], 4);
      stroke([here, drawn[0]], head.look.mass[0], 2, [8, 8]);
    }
    pen.beginPath();
    pen.arc(...toPixel(here), 11, 0, 2 * Math.PI);
    [pen.fillStyle, pen.strokeStyle, pen.lineWidth] = [head.look.point, head.look.mass[0], 3];
    pen.fill();
    pen.stroke();
  }
  function add(point) {
    const last = drawn[drawn.length - 1];
    const gap = Math.max(...point.map((v, k) => Math.abs(v - last[k]) / (high[k] - low[k])));
    if (gap < 0.006) return;
    drawn.push(point);
    events.move(point);
  }
  function abandon() { drawn = null; }
  function close() {
    const loop = drawn;
    drawn = null;
    if (loop && loop.length > 2) events.close(loop);
  }
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    drawn = [toShape(event)];
    events.begin(drawn[0]);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (drawn && canvas.hasPointerCapture(event.pointerId)) add(toShape(event));
  });
  canvas.addEventListener("pointerup", close);
  canvas.addEventListener("pointercancel", () => { drawn = null; });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };
    const step = steps[event.key];
    if (step) {
      const from = events.goal().map((v, k) => v + 0.04 * step[k] * (high[k] - low[k]));
      if (drawn) add(within(from)); else events.move(within(from));
    } else if (event.key === "Enter") {
      if (drawn) close(); else { drawn = [events.goal()]; events.begin(drawn[0]); }
    } else if (event.key === "Escape") drawn = null;
    else return;
    event.preventDefault();
  });
  return { frame, paint, draw, centre, abandon, get pair() { return pair; }, get low() { return low; },
    get high() { return high; }, get values() { return values; } };
}
