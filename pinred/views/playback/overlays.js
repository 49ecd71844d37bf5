// Overlays of the player: axes of bodies, markers of ball joints, the momentum sphere, gravity.
"use strict";
function overlays(THREE, radius) {
  const flat = (color) => new THREE.MeshBasicMaterial({ color });
  const rod = (r) => new THREE.CylinderGeometry(r, r, 1, 16).translate(0, 0.5, 0);
  const line = (points, color, opacity) => new THREE.Line(
    new THREE.BufferGeometry().setFromPoints(points),
    new THREE.LineBasicMaterial({ color, opacity, transparent: true }));
  function rings(color) { // three equators of the unit sphere
    const round = Array.from({ length: 97 }, (_, k) =>
      new THREE.Vector3(Math.cos(Math.PI * k / 48), Math.sin(Math.PI * k / 48), 0));
    return ["X", "Y", "Z"].map((axis) => {
      const ring = line(round, color, 0.55);
      ring.geometry[`rotate${axis}`](Math.PI / 2);
      return ring;
    });
  }
  function shell(color, opacity) { // transparent, because the robot is inside
    return new THREE.Mesh(new THREE.SphereGeometry(1, 48, 32), new THREE.MeshPhongMaterial({
      color, opacity, transparent: true, depthWrite: false }));
  }
  function axes(length, thick) {
    const frame = new THREE.Group();
    [[1, 0, 0, 0xcc3311], [0, 1, 0, 0x009e73], [0, 0, 1, 0x0055cc]].forEach(([x, y, z, color]) => {
      const axis = new THREE.Mesh(rod(thick), flat(color));
      axis.scale.y = length;
      axis.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), new THREE.Vector3(x, y, z));
      frame.add(axis);
    });
    return frame;
  }
  function marker() { // a ball joint, with the axes of the body that it moves
    const ball = axes(0.13 * radius, 0.008 * radius);
    ball.add(new THREE.Mesh(new THREE.SphereGeometry(0.035 * radius, 24, 16), flat(0x7b4fa3)));
    return ball;
  }
  function sphere(path) { // as large as the arrow is long, so that its tip runs along the path
    const globe = new THREE.Group(), points = [];
    for (let k = 0; k < path.length; k += 3) points.push(new THREE.Vector3(...path.subarray(k, k + 3)));
    const track = line(points, 0xaa3377, 1);
    track.frustumCulled = false;
    globe.add(shell(0xaa3377, 0.08), ...rings(0x8a6d80), track);
    globe.scale.setScalar(1.25 * radius);
    return globe;
  }
  function letter(text, size, color) { // always faces the viewer
    const canvas = document.createElement("canvas"), side = canvas.width = canvas.height = 64;
    const context = canvas.getContext("2d");
    Object.assign(context, { font: `italic ${0.75 * side}px serif`, textAlign: "center",
      textBaseline: "middle", fillStyle: `#${color.toString(16).padStart(6, "0")}` });
    context.fillText(text, side / 2, side / 2);
    const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas) }));
    sprite.scale.setScalar(size);
    return sprite;
  }
  function pointer(vector, length, color, text) { // an arrow of fixed direction, about its middle
    const thin = 0.012 * radius, head = 0.3 * length, arrow = new THREE.Group();
    const shaft = new THREE.Mesh(rod(thin), flat(color));
    const tip = new THREE.Mesh(new THREE.ConeGeometry(4 * thin, head, 24), flat(color));
    shaft.position.y = -0.5 * length;
    shaft.scale.y = length - head;
    tip.position.y = 0.5 * (length - head);
    const label = letter(text, 0.45 * length, color);
    label.position.y = -0.65 * length; // behind the tail
    arrow.add(shaft, tip, label);
    arrow.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), vector.clone().normalize());
    return arrow;
  }
  return { flat, rod, rings, shell, axes, marker, sphere, pointer };
}
