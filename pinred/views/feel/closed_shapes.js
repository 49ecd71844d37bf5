// Shapes of the robot at the coordinates u that sliders move.  With closed loops, the dependent joints
// follow by Newton's method from the last shape.
"use strict";
class OutOfReach extends Error {}
const LONGEST = 0.1; // longest step along which a closed shape is followed [rad | fraction of the length]
const SINGULAR = 1e-3; // smallest pivot of the scaled equations: nearer to a dead point, rates are huge
function openShapes() { // without loops, u are the coordinates themselves
  return { shape: (u) => u, rates: (u, udot) => [u, udot], state: null };
}
function closedShapes(head, size, loops) {
  const { independent, dependent, units, low, high, names } = head, k = dependent.length;
  const out = new Float64Array(k + k * size);
  let w = head.start.slice();
  // Limits that the first shape violates do not hold.
  const bounded = dependent.map((j, i) => w[j] >= low[i] && w[j] <= high[i]);
  function factor(w) { // equations, Jacobian, and the LU factors of the columns of dependent joints
    loops(w, out);
    const rows = Array.from({ length: k }, (_, i) => dependent.map((j) => out[k + j * k + i] * units[j]));
    const largest = Math.max(...rows.flat().map(Math.abs), 0), order = rows.map((_, i) => i);
    let side = 1, least = Infinity;
    for (let c = 0; c < k; c++) {
      let best = c;
      for (let i = c; i < k; i++) if (Math.abs(rows[i][c]) > Math.abs(rows[best][c])) best = i;
      if (best !== c) { [rows[c], rows[best]] = [rows[best], rows[c]]; [order[c], order[best]] = [order[best], order[c]]; side = -side; }
      const pivot = rows[c][c];
      least = Math.min(least, Math.abs(pivot));
      if (!(Math.abs(pivot) > SINGULAR * largest)) throw new OutOfReach("the loops have a dead point here");
      side *= Math.sign(pivot);
      for (let i = c + 1; i < k; i++) {
        const by = rows[i][c] /= pivot;
        for (let j = c + 1; j < k; j++) rows[i][j] -= by * rows[c][j];
      }
    }
    function solve(right) { // −J_D⁻¹ right, for the dependent joints
      const x = order.map((i) => -right[i]);
      for (let i = 0; i < k; i++) for (let j = 0; j < i; j++) x[i] -= rows[i][j] * x[j];
      for (let i = k - 1; i >= 0; i--) {
        for (let j = i + 1; j < k; j++) x[i] -= rows[i][j] * x[j];
        x[i] /= rows[i][i];
      }
      return x.map((v, i) => v * units[dependent[i]]);
    }
    const along = (rate) => Array.from({ length: k }, (_, i) => // J_I u̇
      independent.reduce((sum, j, a) => sum + out[k + j * k + i] * rate[a], 0));
    return { side, solve, along, residual: Array.from(out.subarray(0, k)) };
  }
  function follow(step) { // moves the independent joints by a short step
    let at = factor(w), last = Infinity;
    const side = at.side, next = w.slice();
    let change = at.solve(at.along(step));
    independent.forEach((j, a) => { next[j] += step[a]; });
    for (let count = 0; count < 20; count++) {
      dependent.forEach((j, i) => { next[j] += change[i]; });
      const most = Math.max(...change.map((v, i) => Math.abs(v) / units[dependent[i]]));
      if (!(most < 1)) break;
      if (count > 0 && (most <= 1e-14 || (most < 1e-10 && most >= last))) {
        if (at.side !== side) break; // the step has passed a dead point
        dependent.forEach((j, i) => {
          if (bounded[i] && (next[j] < low[i] - 1e-9 || next[j] > high[i] + 1e-9))
            throw new OutOfReach(`${names[i]} is at its limit`);
        });
        return next;
      }
      if (count > 0) last = most;
      at = factor(next);
      change = at.solve(at.residual);
    }
    throw new OutOfReach("the loops do not close beyond this shape");
  }
  function shape(u) {
    const from = independent.map((j) => w[j]);
    const far = Math.max(...u.map((v, a) => Math.abs(v - from[a]) / units[independent[a]]), 0);
    const count = Math.ceil(far / LONGEST);
    for (let n = 1; n <= count; n++) {
      const goal = n === count ? u : from.map((v, a) => v + (u[a] - v) * n / count);
      const next = follow(goal.map((v, a) => v - w[independent[a]]));
      independent.forEach((j, a) => { next[j] = goal[a]; });
      w = next;
    }
    return w;
  }
  function rates(u, udot) { // [w, ẇ]
    const here = shape(u), at = factor(here), by = at.solve(at.along(udot)), wdot = new Array(size).fill(0);
    independent.forEach((j, a) => { wdot[j] = udot[a]; });
    dependent.forEach((j, i) => { wdot[j] = by[i]; });
    return [here, wdot];
  }
  return { shape, rates, get state() { return w; }, set state(value) { w = value; } };
}
