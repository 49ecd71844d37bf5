// Draws a Playback on the stage. page.py writes all numbers into the page.
"use strict";
(() => {
  const { head, array } = readPage();
  const at = stage(head, array), { THREE, $, viewer, node, put, reduced, draws, look, on, set } = at;

  const times = array(head.t), count = times.length, end = times[count - 1];
  const com = array(head.com);
  const poses = array(head.placements), joints = head.joints.length;
  const ghostPoses = head.ghost ? array(head.ghost.placements) : null;
  const apart = head.ghost ? array(head.ghost.apart) : null;
  const ellipsoid = array(head.ellipsoid);
  const momentum = array(head.momentum.vector), tail = array(head.momentum.tail);
  const still = head.momentum.largest === 0;

  const shade = new THREE.MeshPhongMaterial({ color: look.ghost[0], opacity: look.ghost[1], transparent: true,
    side: THREE.DoubleSide, flatShading: true });
  const ghost = ghostPoses ? at.robot("Ghost", () => shade) : [];

  const hull = new THREE.Group();
  hull.add(draws.shell(look.inertia), ...draws.rings(look.inertia_rings));
  hull.matrixAutoUpdate = false;
  put(hull, "Locked inertia");

  const sphere = head.sphere && draws.sphere(array(head.sphere.path));
  if (sphere) put(sphere, "Momentum sphere");

  const gravity = new THREE.Vector3(...head.gravity), heavy = gravity.length() > 0;
  const weight = heavy && draws.weight(gravity);
  if (heavy) put(at.seenThrough(weight.object, 3), "Gravity");

  const sparks = new Map(); // joint: its flash and the times of its impacts
  for (const [time, joint] of head.impacts) {
    if (!sparks.has(joint)) {
      const ball = draws.dot(look.impact);
      put(at.seenThrough(ball, 6), "Impacts", `${joint}`);
      sparks.set(joint, { ball, times: [] });
    }
    sparks.get(joint).times.push(time);
  }
  const fade = look.fade * head.speed; // time of the motion in which a flash fades [s]
  function flash(t) {
    for (const [joint, { ball, times: hits }] of sparks) {
      const last = hits.filter((time) => time <= t).pop();
      ball.material.opacity = last === undefined ? 0 : Math.max(0, 1 - (t - last) / fade);
      ball.visible = ball.material.opacity > 0;
      ball.position.copy(reduced[joint].position);
    }
  }

  const trail = new THREE.Group(), track = new THREE.BufferGeometry();
  track.setAttribute("position", new THREE.BufferAttribute(com, 3));
  const stub = new THREE.BufferGeometry(); // from the last frame to the current CoM
  stub.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6), 3));
  for (const part of [track, stub]) {
    const line = new THREE.Line(part, new THREE.LineBasicMaterial({ color: look.mass[0] }));
    line.frustumCulled = false; // its drawn range changes
    trail.add(line);
  }
  put(at.seenThrough(trail, 4), "CoM trail");

  // -- one frame ----------------------------------------------------------------------------
  function locate(t) {
    let low = 0, high = count - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t) low = middle; else high = middle;
    }
    return [low, Math.min(1, Math.max(0, (t - times[low]) / (times[high] - times[low])))];
  }
  const mix = (values, size, k, s) =>
    Array.from({ length: size }, (_, i) =>
      values[size * k + i] * (1 - s) + values[size * (k + 1) + i] * s);
  function place(object, all, here, next, s) {
    object.position.set(...[0, 1, 2].map((i) => all[here + i] * (1 - s) + all[next + i] * s));
    object.quaternion.fromArray(all, here + 3).slerp(new THREE.Quaternion().fromArray(all, next + 3), s);
  }
  const aside = head.aside;
  function draw(t) {
    const [k, s] = locate(t);
    reduced.forEach((object, i) =>
      place(object, poses, 7 * (k * joints + i), 7 * ((k + 1) * joints + i), s));
    ghost.forEach((object, i) => {
      place(object, ghostPoses, 7 * (k * joints + i), 7 * ((k + 1) * joints + i), s);
      if (on["Ghost beside"]) object.position.add(new THREE.Vector3(...aside));
    });
    const c = mix(com, 3, k, s), e = mix(ellipsoid, 9, k, s);
    hull.matrix.set(e[0], e[1], e[2], c[0], e[3], e[4], e[5], c[1], e[6], e[7], e[8], c[2], 0, 0, 0, 1);
    hull.matrixWorldNeedsUpdate = true;
    const vector = mix(momentum, 3, k, s);
    at.point(mix(tail, 3, k, s), vector, head.momentum.largest);
    at.markJoints(c);
    flash(t);
    if (heavy) weight.centre(c.map((value, i) => value + head.gravity_at[i]));
    if (sphere) {
      sphere.position.fromArray(mix(tail, 3, k, s));
      sphere.quaternion.copy(reduced[head.sphere.joint].quaternion);
    }
    track.setDrawRange(0, k + 1);
    stub.attributes.position.array.set([...com.subarray(3 * k, 3 * k + 3), ...c]);
    stub.attributes.position.needsUpdate = true;
    const shift = on["Follow"] ? c : head.middle;
    at.carry(shift);
    at.lay(c, on["Follow"]);
    if (picture && on["Shape"] && fold.open) picture(k, s);
    $("clock").textContent = `${t.toFixed(2)} of ${end.toFixed(2)} s`;
    $("scrub").value = 1000 * (t - times[0]) / (end - times[0]);
    $("words").textContent = words(Math.hypot(...vector), k);
    viewer.set_dirty();
  }
  function words(size, k) {
    const lines = [`${head.momentum.words}: ` +
      (still ? "zero" : `${size.toPrecision(4)} ${head.momentum.unit}`)];
    if (apart) lines.push(`ghost: full ABA, ${apart[k].toExponential(1)} m away`);
    if (head.note) lines.push(head.note);
    return lines.join(" · ");
  }

  const picture = head.panel && shapePanel(
    head.panel, look, array, mix, ...document.querySelectorAll("#panel canvas, #panel select"),
    () => draw(now));

  // -- the camera ---------------------------------------------------------------------------
  const chosen = {}; // cards that the user has opened or folded
  const fold = document.querySelector("#panel details");
  function tidy() { // in small windows cards are folded so that the robot is visible
    const details = document.querySelector("#side details");
    if (!chosen.side) details.open = true;
    if (picture && !chosen.panel) {
      fold.open = true;
      if (at.cramped()) fold.open = false;
    }
    if (!chosen.side && at.cramped()) details.open = false;
  }
  const refit = () => { if (at.moved) at.aim(); else frameAll(); };
  function frameAll() {
    const side = on["Ghost"] && on["Ghost beside"] ? aside.map((v) => v / 2) : [0, 0, 0];
    at.frameBall((on["Follow"] ? head.reach : head.span) + Math.hypot(...side), side);
  }

  // -- controls -----------------------------------------------------------------------------
  const toggle = (...options) => at.toggle(...options, () => draw(now));
  let started = false;
  toggle("Robot", "robot", "", true, set("Robot"));
  toggle("See-through", "see-through robot", "", false, at.seeThrough);
  if (ghostPoses) {
    toggle("Ghost", "ghost: full ABA", look.ghost[0], true, (v) => { set("Ghost")(v); frameAll(); });
    toggle("Ghost beside", "ghost beside, not over", "", true, frameAll);
  }
  toggle("Locked inertia", "locked inertia", look.inertia[0], true, set("Locked inertia"));
  if (!still) toggle("Momentum", "momentum", look.momentum[0], true, set("Momentum"));
  if (sphere) toggle("Momentum sphere", `momentum seen from ${head.sphere.body}`, look.sphere[0], true, set("Momentum sphere"));
  if (at.balls.length) toggle("Ball joints", "ball joints", look.ball[0], true, set("Ball joints"));
  if (heavy) toggle("Gravity", `gravity: ${Number(gravity.length().toPrecision(4))} m/s²`, look.gravity[0], true, set("Gravity"));
  toggle("Base frame", "base frame", look.axes[1], true, set("Base frame"));
  toggle("CoM trail", "centre of mass and its trail", look.mass[0], true, set("CoM trail"));
  if (picture)
    toggle("Shape", "shape and curvature", look.point, true, (v) => {
      $("panel").hidden = !v;
      if (started) fold.open = chosen.panel = true;
      refit();
    });
  else $("panel").hidden = true;
  toggle("Grid", "grid", look.grid_mark, true, set("Grid"));
  toggle("Follow", "follow the centre of mass", "", head.follow, frameAll);

  let now = times[0], playing = true, speed = head.speed, last = null;
  const setPlaying = (value) => {
    playing = value;
    last = null;
    $("play").textContent = value ? "pause" : "play";
    if (!value) at.rest();
  };
  $("play").onclick = () => {
    if (!playing && now >= end) now = times[0];
    setPlaying(!playing);
  };
  $("scrub").oninput = () => {
    setPlaying(false);
    now = times[0] + (end - times[0]) * Number($("scrub").value) / 1000;
    draw(now);
  };
  const speeds = [...new Set([0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10, 100, head.speed])].sort((a, b) => a - b);
  speeds.forEach((v) => $("speed").add(new Option(`×${v}`, String(v), v === speed, v === speed)));
  $("speed").onchange = () => { speed = Number($("speed").value); };
  at.showTitle(document.querySelector("#side summary"));
  document.querySelector("#side summary").onclick = () => { chosen.side = true; };
  document.querySelector("#side details").ontoggle = () => refit();
  document.querySelector("#panel summary").onclick = () => { chosen.panel = true; };
  fold.ontoggle = () => { refit(); draw(now); };

  function step(stamp) {
    requestAnimationFrame(step);
    if (playing && last !== null) {
      at.pace((stamp - last) / 1000);
      now += speed * (stamp - last) / 1000;
      if (now > end) {
        if ($("loop").checked) now = times[0] + (now - times[0]) % (end - times[0]);
        else { now = end; setPlaying(false); }
      }
      draw(now);
    }
    last = stamp;
  }
  addEventListener("resize", () => { tidy(); refit(); draw(now); });
  viewer.set_3d_pane_size();
  at.starts.forEach((start) => start());
  started = true;
  draw(now); // writes the texts whose size tidy() measures
  tidy();
  frameAll();
  draw(now);
  requestAnimationFrame(step);
  const show = (t) => { setPlaying(false); now = Math.min(end, Math.max(times[0], t)); draw(now); };
  window.pinred = {
    loaded: performance.now(), // [ms] since the page was asked for
    begin: times[0],
    end,
    get time() { return now; },
    get playing() { return playing; },
    play: () => setPlaying(true),
    pause: () => setPlaying(false),
    seek: (t) => { show(t); viewer.render(); },
    node, // three.js object at a path of the viewer's scene
    project: at.project,
  };
})();
