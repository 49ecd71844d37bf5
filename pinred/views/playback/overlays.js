// Overlays of the player: axes of bodies, markers of ball joints, the momentum sphere, gravity.
"use strict";
function overlays(THREE, radius, look) { // look: colours and sizes, see Look in colours_and_view_options.py
  const flat = (color) => new THREE.MeshBasicMaterial({ color });
  const rod = (r) => new THREE.CylinderGeometry(r, r, 1, 16).translate(0, 0.5, 0);
  const line = (points, color, opacity) => new THREE.Line(
    new THREE.BufferGeometry().setFromPoints(points),
    new THREE.LineBasicMaterial({ color, opacity, transparent: true }));
  function rings([color, opacity]) { // three equators of the unit sphere
    const round = Array.from({ length: 97 }, (_, k) =>
      new THREE.Vector3(Math.cos(Math.PI * k / 48), Math.sin(Math.PI * k / 48), 0));
    return ["X", "Y", "Z"].map((axis) => {
      const ring = line(round, color, opacity);
      ring.geometry[`rotate${axis}`](Math.PI / 2);
      return ring;
    });
  }
  function shell([color, opacity]) { // transparent, because the robot is inside
    return new THREE.Mesh(new THREE.SphereGeometry(1, 48, 32), new THREE.MeshPhongMaterial({
      color, opacity, transparent: true, depthWrite: false }));
  }
  const up = new THREE.Vector3(0, 1, 0);
  function axes([length, thick]) {
    const frame = new THREE.Group();
    look.axes.forEach((color, k) => {
      const axis = new THREE.Mesh(rod(thick * radius), flat(color));
      axis.scale.y = length * radius;
      axis.quaternion.setFromUnitVectors(up, new THREE.Vector3().setComponent(k, 1));
      frame.add(axis);
    });
    return frame;
  }
  const dot = ([color, size]) => new THREE.Mesh(new THREE.SphereGeometry(size * radius, 24, 16), flat(color));
  function marker() { // a ball joint, with the axes of the body that it moves
    const ball = axes(look.ball_axes);
    ball.add(dot(look.ball));
    return ball;
  }
  function sphere(path) { // as large as the arrow is long, so that its tip runs along the path
    const globe = new THREE.Group(), points = [];
    for (let k = 0; k < path.length; k += 3) points.push(new THREE.Vector3(...path.subarray(k, k + 3)));
    const track = line(points, look.sphere[0], 1);
    track.frustumCulled = false;
    globe.add(shell(look.sphere), ...rings(look.sphere_rings), track);
    globe.scale.setScalar(look.arrow_length * radius);
    return globe;
  }
  function letter(text, size, color) { // always faces the viewer
    const canvas = document.createElement("canvas"), side = canvas.width = canvas.height = 64;
    const context = canvas.getContext("2d");
    Object.assign(context, { font: `italic ${0.75 * side}px serif`, textAlign: "center",
      textBaseline: "middle", fillStyle: color });
    context.fillText(text, side / 2, side / 2);
    const sprite = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas) }));
    sprite.scale.setScalar(size);
    return sprite;
  }
  function arrow([color, thin, wide, tall]) {
    const object = new THREE.Group(), head = tall * radius;
    const shaft = new THREE.Mesh(rod(thin * radius), flat(color));
    const tip = new THREE.Mesh(new THREE.ConeGeometry(wide * radius, head, 24), flat(color));
    object.add(shaft, tip);
    function point(tail, vector, length) { // from the tail along a vector
      object.position.fromArray(tail);
      object.quaternion.setFromUnitVectors(up, vector.clone().normalize());
      shaft.scale.y = Math.max(1e-9, length - head);
      tip.position.y = length - 0.5 * head;
    }
    return { object, point };
  }
  function weight(vector) { // the gravity arrow, with its letter behind the tail
    const pointer = arrow(look.gravity), length = look.gravity_length * radius;
    const down = vector.clone().setLength(length), label = letter("g", 0.45 * length, look.gravity[0]);
    label.position.y = -0.15 * length;
    pointer.object.add(label);
    const centre = (middle) => pointer.point(middle.map((v, i) => v - 0.5 * down.getComponent(i)), down, length);
    return { object: pointer.object, centre };
  }
  return { flat, line, rings, shell, axes, dot, marker, sphere, arrow, weight };
}
