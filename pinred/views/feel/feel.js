// Moves the joints by hand; the base follows by the connection.  feel_page.py writes the numbers.
"use strict";
(() => {
  const { head, array } = readPage();
  const at = stage(head, array), { THREE, $, viewer, reduced, look, set } = at;
  const d = head.labels.length, J = head.momentum.spatial;
  const shapes = head.loops ? closedShapes(head.loops, head.size, loops) : openShapes();
  const assembled = shapes.state, motion = lifter(head.size, twist, shapes);
  const canvas = document.querySelector("#panel canvas"), panel = d > 1;
  const start = head.start;
  let w = start.slice(), g = { p: head.base.slice(0, 3), q: head.base.slice(3) };
  let dirty = null; // shape that is drawn
  let queue = []; // shapes to go through
  let stopped = ""; // why the robot could not go on
  let loop = null, playing = false, s = 0, cycles = 0, spinning = false, component = 0;
  const first = () => ({ p: head.base.slice(0, 3), q: head.base.slice(3) });

  // -- motion -------------------------------------------------------------------------------
  const range = head.high.map((v, k) => v - head.low[k]);
  const distance = (a, b) => Math.max(...a.map((v, k) => Math.abs(v - b[k]) / range[k]), 0);
  function straight(to, time) { // moves in a straight line, with the momentum for a time
    const from = w, rate = plus(to, from, -1), path = (u) => [plus(from, rate, u), rate];
    const count = Math.max(1, Math.ceil(40 * distance(from, to)));
    if (!attempt(() => motion.along(g, path, 0, 1, count, spinning ? J : null, time), to)) return;
    w = to;
  }
  function attempt(lift, to) { // moves the base, unless the loops do not close on the way to a shape
    const kept = shapes.state;
    try {
      const next = lift();
      shapes.shape(to);
      g = next;
    } catch (error) {
      if (!(error instanceof OutOfReach)) throw error;
      shapes.state = kept;
      halt(error.message);
      return false;
    }
    return true;
  }
  function halt(reason) {
    [stopped, queue, dirty] = [reason, [], null];
    setPlaying(false);
    if (panel) plane.abandon();
  }
  function follow(dt) { // goes through the queue at a bounded speed
    let left = dt;
    while (queue.length && left > 0) {
      const needed = distance(w, queue[0]) * head.crossing;
      const part = needed > left ? left / needed : 1, used = Math.min(left, needed);
      const goal = queue[0];
      straight(part < 1 ? plus(w, plus(queue[0], w, -1), part) : queue[0].slice(), used);
      if (queue[0] !== goal) return; // stopped
      if (part === 1) queue.shift();
      left -= used;
    }
    if (spinning && left > 0) straight(w.slice(), left);
  }
  function cycle(dt) { // moves along the loop
    let left = dt / head.period * loop.pieces.length;
    while (left > 1e-12) {
      const k = Math.min(loop.pieces.length - 1, Math.floor(s)), part = Math.min(left, k + 1 - s);
      const path = loop.pieces[k], time = head.period / loop.pieces.length;
      const next = path(Math.min(1, s + part - k))[0];
      if (!attempt(() => motion.along(g, path, s - k, part, Math.max(1, Math.ceil(part * 16)), spinning ? J : null, time), next)) return;
      s += part; left -= part;
      w = next;
      if (s >= loop.pieces.length - 1e-12) { s = 0; cycles += 1; }
    }
  }

  // -- words --------------------------------------------------------------------------------
  const bold = (text) => Object.assign(document.createElement("b"), { textContent: text });
  const round = (v, digits = 2) => 
    (Math.abs(v) < 0.5 * 10 ** -digits ? 0 : v).toFixed(digits).replace("-", "−");
  function describe(pose, digits) { // a group element as turn and shift
    const parts = [], u = rotationVector(pose.q), angle = Math.hypot(...u);
    if (head.turns === 1) {
      const k = u.reduce((best, v, i) => Math.abs(v) > Math.abs(u[best]) ? i : best, 0);
      parts.push(`${round(u[k] * 180 / Math.PI, digits)}°`);
    } else if (head.turns === 3) {
      const axis = angle > 1e-9 ? ` about (${u.map((v) => round(v / angle)).join(", ")})` : "";
      parts.push(`${round(angle * 180 / Math.PI, digits)}°${axis}`);
    }
    if (head.linear) parts.push(`${round(Math.hypot(...pose.p), digits + 1)} m`);
    return parts;
  }
  function tell() {
    const moved = compose(inverse(first()), g), parts = describe(moved, 1);
    $("base").replaceChildren(head.turns ? "base turned by " : "base moved by ", bold(parts[0]),
      parts[1] ? `, moved by ${parts[1]}` : "");
    $("stopped").textContent = stopped && `Stopped: ${stopped}.`;
    $("words").textContent = [spinning ? `momentum ${head.momentum.words}` : head.still, head.note]
      .filter(Boolean).join(" · ");
  }
  function tellPhase() {
    if (!loop) {
      $("phase").textContent = "The coloured field is the curvature: a loop turns the base by what it encloses.";
      return;
    }
    const parts = describe(loop.phase, 4);
    $("phase").replaceChildren(`${loop.name}: ${head.turns ? "turns" : "moves"} the base by `, bold(parts[0]),
      `${parts[1] ? `, moves it by ${parts[1]}` : ""} a cycle${J ? ", at zero momentum" : ""}${cycles ? ` · ${cycles} done` : ""}`);
  }

  // -- loops --------------------------------------------------------------------------------
  const setPlaying = (value) => { playing = value; $("play").textContent = value ? "pause" : "play"; };
  const shown = (pieces) => pieces.flatMap((path) => {
    const n = pieces.length > 4 ? 1 : 48;
    return Array.from({ length: n + 1 }, (_, k) => plane.pair.map((j) => path(k / n)[0][j]));
  });
  function take(name, pieces) { // goes to the start of a loop and repeats it
    const kept = shapes.state;
    [loop, s, cycles, stopped] = [null, 0, 0, ""];
    try {
      loop = { name, pieces, phase: motion.phase(pieces), outline: shown(pieces) };
    } catch (error) {
      if (!(error instanceof OutOfReach)) throw error;
      halt(`on ${name}, ${error.message}`);
    }
    shapes.state = kept;
    tellPhase();
    return loop !== null;
  }
  function preset(name) {
    let half = plane.high.map((v, k) => 0.5 * Number($("size").value) * (v - plane.low[k])), c = null;
    for (let k = 0; k < 16 && !c; k++) { // smaller, until the loops close in it
      if (k) half = half.map((v) => 0.8 * v);
      c = plane.centre(plane.values[component], half);
    }
    if (!c) { halt("the loops close in no box of this plane"); return; }
    const pieces = loopsAbout(w, plane.pair).shapes[name](c, half);
    if (!take(name, pieces)) return;
    loop.preset = true;
    queue = [pieces[0](0)[0]];
    setPlaying(true);
  }
  const full = (point) => {
    const shape = goal().slice();
    plane.pair.forEach((joint, k) => { shape[joint] = point[k]; });
    return shape;
  };
  const goal = () => (queue.length ? queue[queue.length - 1] : w);
  const plane = panel && feelPlane(head, curvature, shapes, canvas, {
    goal: () => plane.pair.map((k) => goal()[k]),
    begin(point) { setPlaying(false); loop = null; cycles = 0; stopped = ""; queue.push(full(point)); tellPhase(); },
    move(point) { if (loop) { setPlaying(false); loop = null; tellPhase(); } queue.push(full(point)); },
    close(points) {
      if (take("your loop", loopsAbout(goal(), plane.pair).polygon(points))) queue.push(full(points[0]));
    },
  });

  // -- drawing ------------------------------------------------------------------------------
  const places = new Float64Array(7 * (reduced.length - 2) + 3);
  const root = { p: head.root.slice(0, 3), q: head.root.slice(3) };
  function pose(object, { p, q }) { object.position.set(...p); object.quaternion.set(...q); }
  function draw() {
    placements(shapes.shape(w), places);
    const base = compose(root, g);
    pose(reduced[1], base);
    for (let i = 2; i < reduced.length; i++) {
      const k = 7 * (i - 2);
      pose(reduced[i], compose(base, { p: Array.from(places.subarray(k, k + 3)), q: Array.from(places.subarray(k + 3, k + 7)) }));
    }
    const com = compose(base, { p: Array.from(places.subarray(-3)), q: IDENTITY.q }).p;
    const tail = head.momentum.pivoted ? root.p : com;
    at.point(tail, spinning ? head.momentum.vector : [0, 0, 0], Math.hypot(...head.momentum.vector) || 1);
    at.markJoints(com);
    at.carry(com);
    at.lay(com, true);
    if (panel && cards[1].open) plane.draw(w, loop && loop.outline);
    sliders.forEach(({ input, output, joint }) => {
      if (input !== held) input.value = w[joint];
      output.textContent = input.ariaValueText = head.angles[joint] ? `${round(w[joint] * 180 / Math.PI, 0)}°` : `${round(w[joint])} m`;
    });
    tell();
    viewer.set_dirty();
  }

  // -- controls -----------------------------------------------------------------------------
  let held = null; // slider that the user moves
  const sliders = head.labels.map((label, joint) => {
    const row = document.createElement("label"), input = document.createElement("input");
    const output = document.createElement("output"), name = document.createElement("span");
    name.textContent = name.title = label.replace(/ \[.*/, "");
    Object.assign(input, { type: "range", min: head.low[joint], max: head.high[joint], step: range[joint] / 200, value: w[joint] });
    input.ariaLabel = name.textContent; // the label would name the output
    input.oninput = () => {
      held = input;
      stopped = "";
      setPlaying(false);
      const shape = (queue.length ? queue[0] : w).slice();
      shape[joint] = Number(input.value);
      queue = [shape];
    };
    input.onchange = () => { held = dirty = null; repaint(); };
    row.append(name, output, input);
    $("sliders").append(row);
    return { input, output, joint };
  });
  function repaint() { // the field depends on the other joints
    if (panel) component = plane.frame(plane.pair, goal(), component);
  }
  function choose() { // the joints on the axes
    const pair = [Number($("first").value), Number($("second").value)];
    if (pair[0] === pair[1]) pair[1] = pair[0] ? 0 : 1;
    $("second").value = pair[1];
    [loop, cycles] = [null, 0];
    setPlaying(false);
    component = plane.frame(pair, goal());
    $("component").value = component;
    tellPhase();
  }
  if (panel) {
    for (const id of ["first", "second"])
      head.labels.forEach((label, k) => $(id).add(new Option(label, String(k))));
    head.components.forEach((name, k) => $("component").add(new Option(`curvature: ${name}`, String(k))));
    [$("first").value, $("second").value] = head.pair;
    $("first").onchange = $("second").onchange = choose;
    $("component").onchange = () => { component = Number($("component").value); plane.paint(component); };
    for (const name of Object.keys(loopsAbout(w, head.pair).shapes)) {
      const button = Object.assign(document.createElement("button"), { textContent: name });
      button.onclick = () => preset(name);
      $("presets").append(button);
    }
    $("size").oninput = () => { if (loop && loop.preset) preset(loop.name); };
  } else for (const id of ["panel", "presets", "sizes", "play"]) $(id).hidden = true;
  $("grey").hidden = !head.loops;
  if (!panel) $("panel").style.display = $("presets").style.display = $("sizes").style.display = "none";
  $("play").onclick = () => {
    if (!loop) preset("circle"); else setPlaying(!playing);
  };
  const check = document.querySelector("#momentum input");
  $("momentum").hidden = !J;
  check.onchange = () => { spinning = check.checked; refit(); draw(); };
  $("reset").onclick = () => {
    [w, g, queue, loop, cycles, stopped] = [start.slice(), first(), [], null, 0, ""];
    shapes.state = assembled;
    check.checked = spinning = false;
    setPlaying(false);
    repaint();
    tellPhase();
  };
  at.showTitle(document.querySelector("#side summary"));
  at.toggle("Robot", "robot", "", true, set("Robot"), draw);
  at.toggle("See-through", "see-through robot", "", false, at.seeThrough, draw);
  at.toggle("Base frame", "base frame", look.axes[1], true, set("Base frame"), draw);
  at.toggle("CoM", "centre of mass", look.mass[0], true, set("CoM trail"), draw);
  if (at.balls.length) at.toggle("Ball joints", "ball joints", look.ball[0], true, set("Ball joints"), draw);
  at.toggle("Grid", "grid", look.grid_mark, true, set("Grid"), draw);

  let last = null;
  function step(stamp) {
    requestAnimationFrame(step);
    if (last !== null) at.pace((stamp - last) / 1000);
    const dt = last === null ? 0 : Math.min(0.1, (stamp - last) / 1000), before = cycles;
    last = stamp;
    if (queue.length || !playing || !loop) {
      if (!queue.length && !spinning) {
        if (dirty !== w) { dirty = w; draw(); } else at.rest();
        return;
      }
      follow(dt);
    } else cycle(dt);
    if (cycles !== before) tellPhase();
    draw();
  }
  const frameRobot = () => at.frameBall(spinning ? head.reach : 1.05 * head.radius);
  const refit = () => { if (at.moved) at.aim(); else frameRobot(); };
  addEventListener("resize", () => { if (narrow() && panel && cards[0].open) cards[1].open = false; refit(); draw(); });
  const cards = document.querySelectorAll("#side > details, #panel > details");
  const narrow = () => innerWidth < 560; // only one of the two cards is open
  document.querySelectorAll("details").forEach((details) => {
    details.addEventListener("toggle", () => {
      const other = [...cards].find((card) => card !== details);
      if (details.open && narrow() && panel && [...cards].includes(details)) other.open = false;
      refit();
    });
  });
  if (narrow() && panel) cards[0].open = false;
  viewer.set_3d_pane_size();
  at.starts.forEach((begin) => begin());
  if (panel) {
    component = plane.frame(head.pair, w);
    $("component").value = component;
    tellPhase();
  }
  draw();
  frameRobot();
  draw();
  requestAnimationFrame(step);
  window.pinred = {
    loaded: performance.now(), // [ms] since the page was asked for
    get shape() { return Array.from(w); },
    get closed() { return Array.from(shapes.shape(w)); }, // with the dependent joints
    get stopped() { return stopped; },
    get pose() { return [...g.p, ...g.q]; },
    get loop() { return loop && { name: loop.name, phase: [...loop.phase.p, ...loop.phase.q], cycles }; },
    get resting() { return !queue.length; },
    get playing() { return playing; },
    node: at.node,
    project: at.project,
  };
})();
