// The stage of a page: meshcat's viewer, the robot's shapes, overlays, the grid and the camera.
"use strict";
function readPage() { // the numbers that page.py writes into the page
  const KINDS = { f4: Float32Array, f8: Float64Array, u4: Uint32Array };
  const array = (entry) => new KINDS[entry.type](window.pinredBlob, entry.at, entry.count);
  return { head: JSON.parse(document.getElementById("head").textContent), array };
}
function stage(head, array) {
  const THREE = MeshCat.THREE, $ = (id) => document.getElementById(id);
  const look = head.look, radius = head.radius; // of a ball about the centre of mass that contains the robot

  // -- the viewer ---------------------------------------------------------------------------
  const viewer = new MeshCat.Viewer($("meshcat-pane"));
  viewer.set_property(["Background"], "top_color", look.background[0]);
  viewer.set_property(["Background"], "bottom_color", look.background[1]);
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

  // -- overlays -----------------------------------------------------------------------------
  const draws = overlays(THREE, radius, look);
  function seenThrough(object, order) {
    object.traverse((part) => {
      if (part.material) Object.assign(part.material, { depthTest: false, transparent: true });
      part.renderOrder = order;
    });
    return object;
  }

  const arrow = draws.arrow(look.momentum);
  put(seenThrough(arrow.object, 3), "Momentum");

  const frame = draws.axes(look.base_axes);
  put(seenThrough(frame, 2), "Base frame");

  const balls = head.balls.map((joint) => {
    const marker = draws.marker();
    return [joint, put(seenThrough(marker, 2), "Ball joints", `${joint}`)];
  });
  const dot = new THREE.Group(); // in a group, so that its renderOrder is compared with the arrow's
  dot.add(draws.dot(look.mass));
  put(seenThrough(dot, 5), "CoM trail", "CoM");

  function point(tail, vector, largest) { // the arrow; its length is relative to the largest vector
    const along = new THREE.Vector3(...vector), size = along.length();
    arrow.object.visible = size > 0;
    if (size > 0) arrow.point(tail, along, look.arrow_length * radius * size / largest);
  }
  function markJoints(com) { // overlays that move with joints and the centre of mass
    for (const [joint, marker] of balls) {
      marker.position.copy(reduced[joint].position);
      marker.quaternion.copy(reduced[joint].quaternion);
    }
    frame.position.copy(reduced[1].position);
    frame.quaternion.copy(reduced[1].quaternion);
    dot.position.fromArray(com);
  }

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
        tints.push(...look.grid, Math.max(0, 1 - (x * x + y * y) / (wide * wide)));
      }
  const sides = new THREE.BufferGeometry();
  sides.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  sides.setAttribute("color", new THREE.Float32BufferAttribute(tints, 4));
  const grid = new THREE.LineSegments(
    sides, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false }));
  grid.renderOrder = -1;
  grid.frustumCulled = false;
  put(grid, "Grid");
  function lay(point, follow) { // the grid follows the camera in steps of whole squares
    const by = new THREE.Vector3(...point).sub(new THREE.Vector3(...head.middle));
    grid.position.fromArray(head.grid);
    grid.scale.setScalar(follow ? 1 : head.wide);
    if (!follow) return;
    for (const axis of [row, column])
      grid.position.addScaledVector(axis, cell * Math.round(by.dot(axis) / cell));
    if (wall) grid.position.addScaledVector(normal, by.dot(normal));
  }

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
  const cramped = () => free().least < look.cramped * Math.min(innerWidth, innerHeight);
  function aim() { // put the centre of the picture into the centre of the free area
    const w = innerWidth, h = innerHeight, area = free();
    viewer.camera.fov = look.fov;
    viewer.camera.setViewOffset(w, h, w / 2 - area.x, h / 2 - area.y, w, h);
    viewer.set_dirty();
    return area;
  }
  function frameBall(reach, side = [0, 0, 0]) { // frame a ball of radius `reach`, `side` away from the followed point
    const camera = viewer.camera, area = aim();
    moved = false;
    const least = Math.max(area.least, look.least_area * Math.min(innerWidth, innerHeight)); // cards may cover the whole window
    const half = Math.atan(Math.tan(camera.fov * Math.PI / 360) * least / innerHeight);
    const far = look.margin * reach / Math.sin(half);
    viewer.controls.target.copy(followed).add(toCamera(side));
    camera.position.copy(toCamera(head.eye)).multiplyScalar(far).add(viewer.controls.target);
    camera.near = far / 1000;
    camera.far = far * 1000;
    camera.updateProjectionMatrix();
    viewer.controls.update();
  }

  // -- pace -------------------------------------------------------------------------------
  // While frames are late, they get fewer pixels, at least a quarter; a picture at rest has all.
  let sharp = 1, late = 0;
  function sharpen(value) {
    if (value === sharp) return;
    sharp = value;
    viewer.renderer.setPixelRatio(devicePixelRatio * sharp);
    viewer.render(); // the new buffer is empty
  }
  function pace(seconds) { // time since the last frame of a motion
    late = seconds > 1 / 45 ? late + 1 : Math.max(0, late - 1);
    if (late < 12) return;
    late = 0;
    sharpen(Math.max(0.5, 0.75 * sharp));
  }
  const rest = () => { late = 0; sharpen(1); };

  // -- switches -----------------------------------------------------------------------------
  const on = {}, starts = [];
  const set = (name) => (value) => { node(name).visible = value; };
  function toggle(name, words, mark, value, act, redraw) {
    on[name] = value;
    const label = document.createElement("label"), check = document.createElement("input");
    Object.assign(check, { type: "checkbox", checked: value, name });
    check.onchange = () => { on[name] = check.checked; act(check.checked); redraw(); };
    label.append(check, " ");
    if (mark) label.append(Object.assign(document.createElement("i"), { style: `background:${mark}` }));
    label.append(words);
    $("switches").append(label);
    starts.push(() => act(value));
  }
  function seeThrough(value) {
    for (const [skin, opacity] of skins) {
      skin.opacity = value ? 0.4 * opacity : opacity;
      skin.transparent = skin.opacity < 1;
      skin.depthWrite = !value;
      skin.needsUpdate = true;
    }
  }
  function showTitle(summary) {
    summary.textContent = head.title.replaceAll("_", "_\u200b"); // allow line breaks in long names
    document.title = `${head.title} · pinred`;
  }
  function project(path) { // position of an object's origin in the window [px]
    const object = Array.isArray(path) ? node(...path) : path;
    const at = object.getWorldPosition(new THREE.Vector3()).project(viewer.camera);
    return [(at.x + 1) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight];
  }
  return {
    THREE, $, radius, viewer, node, put, robot, reduced, draws, seenThrough, point, markJoints, lay, carry, free,
    cramped, aim, frameBall, pace, look, rest, on, starts, set, toggle, seeThrough, showTitle, project, balls,
    get moved() { return moved; },
  };
}
