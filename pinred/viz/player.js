// Draws a Playback in meshcat's viewer.  All numbers come from the page (page.py writes them).
"use strict";
(() => {
  const THREE = MeshCat.THREE;
  const $ = (id) => document.getElementById(id);
  const head = JSON.parse($("head").textContent);
  const bytes = Uint8Array.from(atob($("blob").textContent), (c) => c.charCodeAt(0));
  const KINDS = { f4: Float32Array, f8: Float64Array, u4: Uint32Array };
  const array = (entry) => new KINDS[entry.type](bytes.buffer, entry.at, entry.count);

  const times = array(head.t), count = times.length, end = times[count - 1];
  const radius = head.radius; // of the moving robot about its centre of mass
  const com = array(head.com);
  const poses = array(head.placements), joints = head.joints.length;
  const ghostPoses = head.ghost ? array(head.ghost.placements) : null;
  const apart = head.ghost ? array(head.ghost.apart) : null;
  const ellipsoid = array(head.ellipsoid);
  const momentum = array(head.momentum.vector), tail = array(head.momentum.tail);
  const still = head.momentum.largest === 0;
  const bare = location.hash === "#bare"; // for films: no controls
  document.body.classList.toggle("bare", bare);

  // -- the viewer ---------------------------------------------------------------------------
  const viewer = new MeshCat.Viewer($("meshcat-pane"));
  viewer.set_property(["Background"], "top_color", [0.96, 0.97, 0.98]);
  viewer.set_property(["Background"], "bottom_color", [0.78, 0.82, 0.86]);
  viewer.delete_path(["Axes"]);
  const node = (...path) => viewer.scene_tree.find(path).object;
  const put = (object, ...path) => { viewer.set_object(path, object); return node(...path); };

  // -- solids -------------------------------------------------------------------------------
  const meshes = head.meshes.map((mesh) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(array(mesh.vertices), 3));
    geometry.setIndex(new THREE.BufferAttribute(array(mesh.faces), 1));
    return geometry;
  });
  function geometryOf(kind, s) { // three's axis is y, that of a URDF is z
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
  const flat = (color) => new THREE.MeshBasicMaterial({ color });
  function seenThrough(object, order) {
    object.traverse((part) => {
      if (part.material) Object.assign(part.material, { depthTest: false, transparent: true });
      part.renderOrder = order;
    });
    return object;
  }
  const rod = (r) => new THREE.CylinderGeometry(r, r, 1, 16).translate(0, 0.5, 0);

  const hull = put(new THREE.Mesh(new THREE.SphereGeometry(1, 48, 32), new THREE.MeshPhongMaterial({
    color: 0x56b4e9, opacity: 0.3, transparent: true, depthWrite: false })), "Locked inertia");
  hull.matrixAutoUpdate = false;

  const arrow = new THREE.Group();
  const shaft = new THREE.Mesh(rod(0.016 * radius), flat(0xd55e00));
  const tip = new THREE.Mesh(new THREE.ConeGeometry(0.05 * radius, 0.17 * radius, 24), flat(0xd55e00));
  arrow.add(shaft, tip);
  put(seenThrough(arrow, 3), "Momentum");

  const frame = new THREE.Group();
  [[1, 0, 0, 0xcc3311], [0, 1, 0, 0x009e73], [0, 0, 1, 0x0055cc]].forEach(([x, y, z, color]) => {
    const axis = new THREE.Mesh(rod(0.013 * radius), flat(color));
    axis.scale.y = 0.5 * radius;
    axis.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), new THREE.Vector3(x, y, z));
    frame.add(axis);
  });
  put(seenThrough(frame, 2), "Base frame");

  const trail = new THREE.Group(), track = new THREE.BufferGeometry();
  track.setAttribute("position", new THREE.BufferAttribute(com, 3));
  trail.add(new THREE.Line(track, new THREE.LineBasicMaterial({ color: 0x111111 })));
  const dot = new THREE.Group(); // a group, so that its renderOrder counts against the arrow's
  dot.add(new THREE.Mesh(new THREE.SphereGeometry(0.03 * radius, 20, 14), flat(0x111111)));
  trail.children[0].frustumCulled = false; // its bounds change with the draw range
  put(seenThrough(trail, 4), "CoM trail");
  put(seenThrough(dot, 5), "CoM trail", "CoM");

  const cell = head.cell, cells = head.cells;
  const grid = new THREE.GridHelper(cell * cells, cells, 0x8a97a5, 0xb3bdc7).rotateX(Math.PI / 2);
  grid.position.fromArray(head.floor);
  put(grid, "Grid");

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
    frame.position.copy(reduced[1].position);
    frame.quaternion.copy(reduced[1].quaternion);
    dot.position.fromArray(c);
    track.setDrawRange(0, k + 1);
    const shift = on["Follow"] ? c : head.middle;
    carry(shift);
    shapePanel(k, s);
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

  // -- the shape panel ----------------------------------------------------------------------
  const panel = head.panel, canvas = document.querySelector("#panel canvas");
  const pen = canvas.getContext("2d"), box = [64, 14, 436, 404]; // left, top, width, height
  const path = panel ? array(panel.path) : null, field = panel ? array(panel.field) : null;
  const picker = document.querySelector("#panel select");
  let backdrop = null;
  const across = (v, i) => (v - panel.low[i]) / (panel.high[i] - panel.low[i]);
  const px = (a) => box[0] + box[2] * across(a, 0), py = (b) => box[1] + box[3] * (1 - across(b, 1));
  function colour(v) { // −1 blue, 0 white, 1 orange: told apart by the colour-blind
    const strong = v < 0 ? [33, 102, 172] : [217, 95, 2], a = Math.min(1, Math.abs(v));
    return strong.map((c) => 255 + (c - 255) * a);
  }
  function paintBackdrop() {
    const layer = document.createElement("canvas");
    [layer.width, layer.height] = [canvas.width, canvas.height];
    const ink = layer.getContext("2d"), n = panel.fine, c = Number(picker.value || 0);
    ink.font = "20px system-ui, sans-serif";
    if (n) {
      const values = field.subarray(c * n * n, (c + 1) * n * n);
      const most = Math.max(1e-300, values.reduce((m, v) => Math.max(m, Math.abs(v)), 0));
      const image = ink.createImageData(n, n);
      values.forEach((v, at) => {
        const a = Math.floor(at / n), b = at % n, to = 4 * ((n - 1 - b) * n + a);
        image.data.set([...colour(v / most), 255], to);
      });
      const small = document.createElement("canvas");
      small.width = small.height = n;
      small.getContext("2d").putImageData(image, 0, 0);
      ink.drawImage(small, box[0], box[1], box[2], box[3]);
      [-1, -0.5, 0, 0.5, 1].forEach((v, i) => {
        ink.fillStyle = `rgb(${colour(v).map(Math.round)})`;
        ink.fillRect(box[0] + 8 + 26 * i, box[1] + 8, 26, 14);
      });
      ink.fillStyle = "#1d2733";
      const name = panel.components[c].replace(/ \[.*/, "");
      const bound = most < 1e-3 ? most.toExponential(1) : most.toPrecision(2);
      ink.fillText(`± ${bound}  ${name}`, box[0] + 146, box[1] + 23);
    }
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
  function shapePanel(k, s) {
    if (!panel || !on["Shape"]) return;
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
  }
  if (panel) {
    panel.components.forEach((name, i) => picker.add(new Option(`curvature: ${name}`, String(i))));
    picker.hidden = !panel.components.length;
    picker.title = "the joints that are not on the axes are held as they are at first";
    picker.onchange = () => { paintBackdrop(); draw(now); };
    paintBackdrop();
  }

  // -- the camera ---------------------------------------------------------------------------
  const turned = (v) => new THREE.Vector3(v[0], v[2], -v[1]); // meshcat's camera has y up
  const held = new THREE.Vector3(); // the point that camera and lights have been carried to
  function carry(point) {
    const by = turned(point).sub(held);
    held.add(by);
    viewer.camera.position.add(by);
    viewer.controls.target.add(by);
    node("Lights").position.fromArray(point);
  }
  function look() {
    const camera = viewer.camera, reach = on["Follow"] ? head.reach : head.span;
    camera.fov = 30;
    const w = innerWidth, h = innerHeight; // the middle of what the cards leave free
    if (bare) camera.setViewOffset(w, h, panel && on["Shape"] ? -w / 10 : 0, 0, w, h);
    else camera.setViewOffset(w, h, w >= 700 && h >= 740 ? -130 : 0, 24, w, h);
    const half = Math.min(camera.fov, camera.fov * camera.aspect) * Math.PI / 360;
    const far = 1.02 * reach / Math.sin(half);
    const side = on["Ghost"] && on["Ghost beside"] ? aside.map((v) => v / 2) : [0, 0, 0];
    viewer.controls.target.copy(held).add(turned(side));
    camera.position.copy(turned(head.eye)).multiplyScalar(far).add(viewer.controls.target);
    camera.near = far / 1000;
    camera.far = far * 1000;
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
  toggle("Base frame", "base frame", "#009e73", true, set("Base frame"));
  toggle("CoM trail", "centre of mass and its trail", "#111", true, set("CoM trail"));
  if (panel) toggle("Shape", "shape and curvature", "#f0e442", true, (v) => { $("panel").hidden = !v; });
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
  const title = head.title.replaceAll("_", "_\u200b"); // where a long name may be broken
  document.querySelector("#side summary").textContent = title;
  document.querySelector("#side details").open = innerWidth >= 700;
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
  addEventListener("resize", () => look());
  viewer.set_3d_pane_size();
  starts.forEach((start) => start());
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
    node, // the three.js object at a path of the viewer's scene
    project(path) { // where an object's origin is in the window [px]
      const at = node(...path).getWorldPosition(new THREE.Vector3()).project(viewer.camera);
      return [(at.x + 1) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight];
    },
  };
})();
