// Draws a Playback in meshcat's viewer. page.py writes all numbers into the page.
"use strict";
(() => {
  const THREE = MeshCat.THREE;
  const $ = (id) => document.getElementById(id);
  const head = JSON.parse($("head").textContent);
  const bytes = Uint8Array.from(atob($("blob").textContent), (c) => c.charCodeAt(0));
  const KINDS = { f4: Float32Array, f8: Float64Array, u4: Uint32Array };
  const array = (entry) => new KINDS[entry.type](bytes.buffer, entry.at, entry.count);

  const times = array(head.t), count = times.length, end = times[count - 1];
  const radius = head.radius; // of a ball about the centre of mass that contains the robot
  const com = array(head.com);
  const poses = array(head.placements), joints = head.joints.length;
  const ghostPoses = head.ghost ? array(head.ghost.placements) : null;
  const apart = head.ghost ? array(head.ghost.apart) : null;
  const ellipsoid = array(head.ellipsoid);
  const momentum = array(head.momentum.vector), tail = array(head.momentum.tail);
  const still = head.momentum.largest === 0;
  const bare = location.hash === "#bare"; // films have no controls
  document.body.classList.toggle("bare", bare);

  // -- the viewer ---------------------------------------------------------------------------
  const viewer = new MeshCat.Viewer($("meshcat-pane"));
  viewer.set_property(["Background"], "top_color", [0.70, 0.79, 0.88]);
  viewer.set_property(["Background"], "bottom_color", [0.42, 0.52, 0.64]);
  viewer.delete_path(["Axes"]);
  const node = (...path) => viewer.scene_tree.find(path).object;
  node("Lights", "AmbientLight", "<object>").intensity = 0.52; // lower than the default, so that white robots have shades
  const put = (object, ...path) => { viewer.set_object(path, object); return node(...path); };

  // -- solids -------------------------------------------------------------------------------
  const meshes = head.meshes.map((mesh) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(array(mesh.vertices), 3));
    geometry.setIndex(new THREE.BufferAttribute(array(mesh.faces), 1));
    return geometry;
  });
  function geometryOf(kind, s) { // three.js uses the y axis, URDF the z axis
    if (kind === "mesh") return meshes[s[0]];
    if (kind === "box") return new THREE.BoxGeometry(2 * s[0], 2 * s[1], 2 * s[2]);
    if (kind === "sphere") return new THREE.SphereGeometry(s[0], 32, 20);
    if (kind === "ellipsoid") return new THREE.SphereGeometry(1, 32, 20).scale(s[0], s[1], s[2]);
    if (kind === "cone") return new THREE.ConeGeometry(s[0], 2 * s[1], 32).rotateX(Math.PI / 2);
    if (kind === "cylinder")
      return new THREE.CylinderGeometry(s[0], s[0], 2 * s[1], 32).rotateX(Math.PI / 2);
    const outline = []; // a capsule
    for (let k = 0; k <= 20; k++) {
      const angle = -Math.PI / 2 + Math.PI * k / 20;
      outline.push(new THREE.Vector2(s[0] * Math.cos(angle),
        s[0] * Math.sin(angle) + (k < 10 ? -s[1] : s[1])));
    }
    return new THREE.LatheGeometry(outline, 24).rotateX(Math.PI / 2);
  }
  function robot(name, material) {
    return head.joints.map((joint, i) => {
      const group = new THREE.Group();
      for (const solid of head.solids.filter((one) => one.joint === i)) {
        const mesh = new THREE.Mesh(geometryOf(solid.kind, solid.size), material(solid));
        mesh.position.fromArray(solid.placement);
        mesh.quaternion.fromArray(solid.placement, 3);
        group.add(mesh);
      }
      return put(group, name, `${i} ${joint}`);
    });
  }
  const skins = [];
  const reduced = robot("Robot", (solid) => {
    const skin = new THREE.MeshPhongMaterial({
      color: new THREE.Color(...solid.colour), opacity: solid.colour[3],
      transparent: solid.colour[3] < 1, side: THREE.DoubleSide, shininess: 25,
      flatShading: solid.kind === "mesh" });
    skins.push([skin, solid.colour[3]]);
    return skin;
  });
  const shade = new THREE.MeshPhongMaterial({ color: 0x0072b2, opacity: 0.38, transparent: true,
    side: THREE.DoubleSide, flatShading: true });
  const ghost = ghostPoses ? robot("Ghost", () => shade) : [];

  // -- overlays -----------------------------------------------------------------------------
  const draws = overlays(THREE, radius), { flat, rod } = draws;
  function seenThrough(object, order) {
    object.traverse((part) => {
      if (part.material) Object.assign(part.material, { depthTest: false, transparent: true });
      part.renderOrder = order;
    });
    return object;
  }

  const hull = new THREE.Group();
  hull.add(draws.shell(0x56b4e9, 0.13), ...draws.rings(0x1f6fa8));
  hull.matrixAutoUpdate = false;
  put(hull, "Locked inertia");

  const arrow = new THREE.Group();
  const shaft = new THREE.Mesh(rod(0.016 * radius), flat(0xd55e00));
  const tip = new THREE.Mesh(new THREE.ConeGeometry(0.05 * radius, 0.17 * radius, 24), flat(0xd55e00));
  arrow.add(shaft, tip);
  put(seenThrough(arrow, 3), "Momentum");

  const frame = draws.axes(0.5 * radius, 0.013 * radius);
  put(seenThrough(frame, 2), "Base frame");

  const balls = head.balls.map((joint) => {
    const marker = draws.marker();
    return [joint, put(seenThrough(marker, 2), "Ball joints", `${joint}`)];
  });
  const sphere = head.sphere && draws.sphere(array(head.sphere.path));
  if (sphere) put(sphere, "Momentum sphere");

  const trail = new THREE.Group(), track = new THREE.BufferGeometry();
  track.setAttribute("position", new THREE.BufferAttribute(com, 3));
  const stub = new THREE.BufferGeometry(); // from the last frame to the current CoM
  stub.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6), 3));
  for (const part of [track, stub]) {
    const line = new THREE.Line(part, new THREE.LineBasicMaterial({ color: 0x111111 }));
    line.frustumCulled = false; // its drawn range changes
    trail.add(line);
  }
  const dot = new THREE.Group(); // in a group, so that its renderOrder is compared with the arrow's
  dot.add(new THREE.Mesh(new THREE.SphereGeometry(0.03 * radius, 20, 14), flat(0x111111)));
  put(seenThrough(trail, 4), "CoM trail");
  put(seenThrough(dot, 5), "CoM trail", "CoM");

  // Each side of a square is a separate line, because software renderers drop lines that reach
  // behind the camera. The grid fades towards its edge.
  const cell = head.cell, wide = 0.5 * cell * head.cells;
  const normal = new THREE.Vector3(...head.normal), row = new THREE.Vector3(0, 0, 1).cross(normal);
  const wall = row.length() > 0.5;
  if (!wall) row.set(1, 0, 0);
  const column = normal.clone().cross(row), corners = [], tints = [];
  for (let i = 0; i <= head.cells; i++)
    for (let j = 0; j < head.cells; j++)
      for (const [a, b] of [[i, j], [i, j + 1], [j, i], [j + 1, i]]) {
        const x = a * cell - wide, y = b * cell - wide;
        corners.push(...row.clone().multiplyScalar(x).addScaledVector(column, y).toArray());
        tints.push(0.22, 0.30, 0.40, Math.max(0, 1 - (x * x + y * y) / (wide * wide)));
      }
  const sides = new THREE.BufferGeometry();
  sides.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  sides.setAttribute("color", new THREE.Float32BufferAttribute(tints, 4));
  const grid = new THREE.LineSegments(
    sides, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false }));
  grid.renderOrder = -1;
  grid.frustumCulled = false;
  put(grid, "Grid");
  function lay(point) { // the grid follows the camera in steps of whole squares
    const by = new THREE.Vector3(...point).sub(new THREE.Vector3(...head.middle));
    grid.position.fromArray(head.grid);
    grid.scale.setScalar(on["Follow"] ? 1 : head.wide);
    if (!on["Follow"]) return;
    for (const axis of [row, column])
      grid.position.addScaledVector(axis, cell * Math.round(by.dot(axis) / cell));
    if (wall) grid.position.addScaledVector(normal, by.dot(normal));
  }

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
  function place(object, all, at, next, s) {
    object.position.set(...[0, 1, 2].map((i) => all[at + i] * (1 - s) + all[next + i] * s));
    object.quaternion.fromArray(all, at + 3).slerp(new THREE.Quaternion().fromArray(all, next + 3), s);
  }
  const up = new THREE.Vector3(0, 1, 0);
  let aside = head.ghost ? head.ghost.aside : [0, 0, 0];
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
    const vector = new THREE.Vector3(...mix(momentum, 3, k, s)), size = vector.length();
    arrow.visible = size > 0;
    if (size > 0) {
      const length = 1.25 * radius * size / head.momentum.largest;
      arrow.position.fromArray(mix(tail, 3, k, s));
      arrow.quaternion.setFromUnitVectors(up, vector.divideScalar(size));
      shaft.scale.y = Math.max(1e-9, length - 0.17 * radius);
      tip.position.y = length - 0.085 * radius;
    }
    for (const [joint, marker] of balls) {
      marker.position.copy(reduced[joint].position);
      marker.quaternion.copy(reduced[joint].quaternion);
    }
    if (sphere) {
      sphere.position.fromArray(mix(tail, 3, k, s));
      sphere.quaternion.copy(reduced[head.sphere.joint].quaternion);
    }
    frame.position.copy(reduced[1].position);
    frame.quaternion.copy(reduced[1].quaternion);
    dot.position.fromArray(c);
    track.setDrawRange(0, k + 1);
    stub.attributes.position.array.set([...com.subarray(3 * k, 3 * k + 3), ...c]);
    stub.attributes.position.needsUpdate = true;
    const shift = on["Follow"] ? c : head.middle;
    carry(shift);
    lay(c);
    if (picture && on["Shape"]) picture(k, s);
    $("clock").textContent = `${t.toFixed(2)} of ${end.toFixed(2)} s`;
    $("scrub").value = 1000 * (t - times[0]) / (end - times[0]);
    $("words").textContent = words(size, k);
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
    head.panel, array, mix, ...document.querySelectorAll("#panel canvas, #panel select"),
    () => draw(now));

  // -- the camera ---------------------------------------------------------------------------
  const toCamera = (v) => new THREE.Vector3(v[0], v[2], -v[1]); // the y axis of meshcat's camera points up
  const followed = new THREE.Vector3(); // point that camera and lights follow
  function carry(point) {
    const by = toCamera(point).sub(followed);
    followed.add(by);
    viewer.camera.position.add(by);
    viewer.controls.target.add(by);
    node("Lights").position.fromArray(point);
  }
  let moved = false; // whether the user has moved the camera
  viewer.controls.addEventListener("start", () => { moved = true; });
  function free() { // the largest area of the window without cards
    const rows = [0, innerHeight], columns = [0, innerWidth];
    const cards = [...document.querySelectorAll(".card, .dg.main")]
      .map((card) => card.getBoundingClientRect()).filter((card) => card.width * card.height > 0);
    for (const card of cards) { rows.push(card.top, card.bottom); columns.push(card.left, card.right); }
    let best = { least: -1, x: innerWidth / 2, y: innerHeight / 2 }, most = -1;
    for (const left of columns) for (const right of columns) for (const top of rows) for (const bottom of rows) {
      const least = Math.min(right - left, bottom - top);
      const worth = least + 1e-3 * (right - left + bottom - top);
      if (least <= 0 || worth <= most || cards.some((card) => card.left < right
        && card.right > left && card.top < bottom && card.bottom > top)) continue;
      most = worth;
      best = { least, x: (left + right) / 2, y: (top + bottom) / 2 };
    }
    return best;
  }
  const cramped = () => free().least < 0.6 * Math.min(innerWidth, innerHeight);
  const chosen = {}; // cards that the user has opened or folded
  function tidy() { // in small windows cards are folded so that the robot is visible
    const details = document.querySelector("#side details"), box = document.getElementsByName("Shape")[0];
    const show = (value) => { on["Shape"] = box.checked = value; $("panel").hidden = !value; };
    if (!chosen.side) details.open = true;
    if (box && !chosen.panel) { show(true); if (cramped()) show(false); }
    if (!chosen.side && cramped()) details.open = false;
  }
  function aim() { // put the centre of the picture into the centre of the free area
    const w = innerWidth, h = innerHeight, area = free();
    viewer.camera.fov = 30;
    viewer.camera.setViewOffset(w, h, w / 2 - area.x, h / 2 - area.y, w, h);
    viewer.set_dirty();
    return area;
  }
  const refit = () => { if (moved) aim(); else look(); };
  function look() {
    const camera = viewer.camera, area = aim();
    moved = false;
    const side = on["Ghost"] && on["Ghost beside"] ? aside.map((v) => v / 2) : [0, 0, 0];
    const reach = (on["Follow"] ? head.reach : head.span) + Math.hypot(...side);
    const least = Math.max(area.least, 0.2 * Math.min(innerWidth, innerHeight)); // cards may cover the whole window
    const half = Math.atan(Math.tan(camera.fov * Math.PI / 360) * least / innerHeight);
    const far = 1.02 * reach / Math.sin(half);
    viewer.controls.target.copy(followed).add(toCamera(side));
    camera.position.copy(toCamera(head.eye)).multiplyScalar(far).add(viewer.controls.target);
    camera.near = far / 1000;
    camera.far = far * 1000;
    camera.updateProjectionMatrix();
    viewer.controls.update();
  }

  // -- controls -----------------------------------------------------------------------------
  const on = {};
  const set = (name) => (value) => { node(name).visible = value; };
  function toggle(name, words, mark, value, act) {
    on[name] = value;
    const label = document.createElement("label"), check = document.createElement("input");
    Object.assign(check, { type: "checkbox", checked: value, name });
    check.onchange = () => { on[name] = check.checked; act(check.checked); draw(now); };
    label.append(check, " ");
    if (mark) label.append(Object.assign(document.createElement("i"), { style: `background:${mark}` }));
    label.append(words);
    $("switches").append(label);
    starts.push(() => act(value));
  }
  const starts = [];
  let started = false;
  toggle("Robot", "robot", "", true, set("Robot"));
  toggle("See-through", "see-through robot", "", false, (value) => {
    for (const [skin, opacity] of skins) {
      skin.opacity = value ? 0.4 * opacity : opacity;
      skin.transparent = skin.opacity < 1;
      skin.depthWrite = !value;
      skin.needsUpdate = true;
    }
  });
  if (ghostPoses) {
    toggle("Ghost", "ghost: full ABA", "#0072b2", true, (v) => { set("Ghost")(v); look(); });
    toggle("Ghost beside", "ghost beside, not over", "", true, look);
  }
  toggle("Locked inertia", "locked inertia", "#56b4e9", true, set("Locked inertia"));
  if (!still) toggle("Momentum", "momentum", "#d55e00", true, set("Momentum"));
  if (sphere) toggle("Momentum sphere", `momentum seen from ${head.sphere.body}`, "#aa3377", true, set("Momentum sphere"));
  if (balls.length) toggle("Ball joints", "ball joints", "#7b4fa3", true, set("Ball joints"));
  toggle("Base frame", "base frame", "#009e73", true, set("Base frame"));
  toggle("CoM trail", "centre of mass and its trail", "#111", true, set("CoM trail"));
  if (picture)
    toggle("Shape", "shape and curvature", "#f0e442", true, (v) => {
      $("panel").hidden = !v;
      chosen.panel = started;
      refit();
    });
  else $("panel").hidden = true;
  toggle("Grid", "grid", "#8a97a5", true, set("Grid"));
  toggle("Follow", "follow the centre of mass", "", head.follow, look);

  let now = times[0], playing = true, speed = head.speed, last = null;
  const setPlaying = (value) => { playing = value; last = null; $("play").textContent = value ? "pause" : "play"; };
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
  const title = head.title.replaceAll("_", "_\u200b"); // allow line breaks in long names
  document.querySelector("#side summary").textContent = title;
  document.querySelector("#side summary").onclick = () => { chosen.side = true; };
  document.querySelector("#side details").ontoggle = () => refit();
  document.title = `${head.title} · pinred`;

  function step(stamp) {
    requestAnimationFrame(step);
    if (playing && last !== null) {
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
  starts.forEach((start) => start());
  started = true;
  draw(now); // writes the texts whose size tidy() measures
  tidy();
  look();
  draw(now);
  requestAnimationFrame(step);
  window.pinred = {
    loaded: performance.now(), // [ms] since the page was asked for
    begin: times[0],
    end,
    get time() { return now; },
    get playing() { return playing; },
    play: () => setPlaying(true),
    pause: () => setPlaying(false),
    seek: (t) => { setPlaying(false); now = Math.min(end, Math.max(times[0], t)); draw(now); viewer.render(); },
    node, // three.js object at a path of the viewer's scene
    project(path) { // position of an object's origin in the window [px]
      const object = Array.isArray(path) ? node(...path) : path;
      const at = object.getWorldPosition(new THREE.Vector3()).project(viewer.camera);
      return [(at.x + 1) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight];
    },
  };
})();
