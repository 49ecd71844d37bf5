// Closed paths of two joints, as lists of smooth paths s in 0 … 1 → [w, dw/ds].
"use strict";
function loopsAbout(w, pair) { // the other joints keep their values in w
  function piece(at) {
    return (s) => {
      const [point, rate] = at(s), shape = Array.from(w), speed = new Array(w.length).fill(0);
      pair.forEach((joint, k) => { shape[joint] = point[k]; speed[joint] = rate[k]; });
      return [shape, speed];
    };
  }
  const TAU = 2 * Math.PI;
  const line = (a, b) => piece((s) => [plus(a, plus(b, a, -1), s), plus(b, a, -1)]);
  function polygon(corners) {
    return corners.map((corner, k) => line(corner, corners[(k + 1) % corners.length]));
  }
  const [x, y] = [0, 1];
  const shapes = { // about `c`, with half widths `a`; all but the line have an area
    circle: (c, a) => [piece((s) => [
      [c[x] + a[x] * Math.cos(TAU * s), c[y] + a[y] * Math.sin(TAU * s)],
      [-TAU * a[x] * Math.sin(TAU * s), TAU * a[y] * Math.cos(TAU * s)]])],
    square: (c, a) => polygon([[1, 1], [-1, 1], [-1, -1], [1, -1]].map(
      (corner) => [c[x] + a[x] * corner[x], c[y] + a[y] * corner[y]])),
    "figure eight": (c, a) => [piece((s) => [
      [c[x] + a[x] * Math.sin(TAU * s), c[y] + a[y] * Math.sin(2 * TAU * s)],
      [TAU * a[x] * Math.cos(TAU * s), 2 * TAU * a[y] * Math.cos(2 * TAU * s)]])],
    "there and back": (c, a) => polygon([[c[x] + a[x], c[y] + a[y]], [c[x] - a[x], c[y] - a[y]]]),
  };
  return { polygon, shapes, line };
}
