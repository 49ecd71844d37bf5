// Lifts of paths in shape space to the group: ξ = −A ẇ + P_b⁻¹ μ, with μ = Ad_gᵀ J.
// Twists are [linear; angular], poses are {p, q} with the quaternion (x, y, z, w).
"use strict";
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, b, s = 1) => a.map((v, k) => v + s * b[k]);
const scaled = (a, s) => a.map((v) => s * v);
const IDENTITY = { p: [0, 0, 0], q: [0, 0, 0, 1] };
function rotated(q, v) {
  const t = scaled(cross(q, v), 2);
  return plus(plus(v, t, q[3]), cross(q, t));
}
function compose(a, b) {
  const [x, y, z, w] = a.q, [i, j, k, l] = b.q;
  const q = [w * i + l * x + y * k - z * j, w * j + l * y + z * i - x * k,
    w * k + l * z + x * j - y * i, w * l - x * i - y * j - z * k];
  return { p: plus(a.p, rotated(a.q, b.p)), q: scaled(q, 1 / Math.hypot(...q)) };
}
function inverse(g) {
  const q = [-g.q[0], -g.q[1], -g.q[2], g.q[3]];
  return { p: scaled(rotated(q, g.p), -1), q };
}
function exponential(xi) {
  const v = xi.slice(0, 3), u = xi.slice(3), s = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
  const a = Math.sqrt(s), small = s < 1e-4;
  const f = small ? 0.5 - s / 48 * (1 - s / 80) : Math.sin(a / 2) / a; // sin(a/2)/a
  const b = small ? 0.5 - s / 24 * (1 - s / 30) : (1 - Math.cos(a)) / s;
  const c = small ? 1 / 6 - s / 120 * (1 - s / 42) : (a - Math.sin(a)) / (a * s);
  const across = cross(u, v);
  return { p: plus(plus(v, across, b), cross(u, across), c), q: [...scaled(u, f), Math.cos(a / 2)] };
}
function bracket(a, b) {
  const v = a.slice(0, 3), u = a.slice(3), dv = b.slice(0, 3), du = b.slice(3);
  return [...plus(cross(u, dv), cross(du, v), -1), ...cross(u, du)];
}
function bodyMomentum(g, J) { // Ad_gᵀ J
  const back = (v) => rotated([-g.q[0], -g.q[1], -g.q[2], g.q[3]], v), f = J.slice(0, 3);
  return [...back(f), ...back(plus(J.slice(3), cross(g.p, f), -1))];
}
function rotationVector(q) { // of the shortest rotation
  const s = q[3] < 0 ? -1 : 1, n = Math.hypot(q[0], q[1], q[2]);
  return scaled(q.slice(0, 3), n ? 2 * s * Math.atan2(n, s * q[3]) / n : 2 * s);
}
function lifter(m, twist, shapes = openShapes()) { // paths are those of u, see closed_shapes.js
  const y = new Float64Array(2 * m + 6), out = new Float64Array(6), none = [0, 0, 0, 0, 0, 0];
  function velocity(u, udot, momentum = none) {
    const [w, wdot] = shapes.rates(u, udot);
    y.set(w); y.set(wdot, m); y.set(momentum, 2 * m);
    twist(y, out);
    return Array.from(out);
  }
  const early = 0.5 - Math.sqrt(3) / 6, late = 0.5 + Math.sqrt(3) / 6;
  function magnus(g, path, s, h) { // fourth order, with the connection at two Gauss points
    const a = velocity(...path(s + early * h)), b = velocity(...path(s + late * h));
    const middle = scaled(plus(a, b), h / 2);
    return compose(g, exponential(plus(middle, bracket(a, b), Math.sqrt(3) / 12 * h * h)));
  }
  function rungeKutta(g, path, s, h, J, time) { // Munthe-Kaas, fourth order, as μ depends on g
    const slope = (at, u) => {
      const [w, wdot] = path(at), here = compose(g, exponential(u));
      const xi = velocity(w, wdot, scaled(bodyMomentum(here, J), time));
      const turn = bracket(u, xi);
      return plus(plus(xi, turn, 1 / 2), bracket(u, turn), 1 / 12);
    };
    const a = slope(s, none), b = slope(s + h / 2, scaled(a, h / 2));
    const c = slope(s + h / 2, scaled(b, h / 2)), d = slope(s + h, scaled(c, h));
    const sum = plus(plus(a, d), plus(b, c), 2);
    return compose(g, exponential(scaled(sum, h / 6)));
  }
  // Moves the pose g along path(s) → [w, dw/ds] from s to s + h in `count` steps.  With a spatial
  // momentum J, one unit of s takes `time` seconds.
  function along(g, path, s, h, count, J = null, time = 1) {
    for (let k = 0; k < count; k++) {
      const start = s + k * h / count;
      g = J ? rungeKutta(g, path, start, h / count, J, time) : magnus(g, path, start, h / count);
    }
    return g;
  }
  // Returns the phase of a loop, a list of smooth paths over 0 … 1.  Steps are halved until the pose
  // changes by less than the tolerance.
  function phase(pieces, tolerance = 1e-11) {
    let previous = null;
    for (let count = 16; count <= 8192; count *= 2) {
      let g = IDENTITY;
      for (const path of pieces) g = along(g, path, 0, 1, count);
      const change = previous && compose(inverse(previous), g);
      if (change && Math.hypot(...change.p, ...rotationVector(change.q)) < tolerance) return g;
      previous = g;
    }
    return previous;
  }
  return { velocity, along, phase };
}
