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
  const LU = new Float64Array(k * k), order = new Int32Array(k), x = new Float64Array(k);
  const scale = Float64Array.from(dependent, (j) => units[j]), m = independent.length;
  // Evaluates the equations and their Jacobian in `out`, and factors the columns of dependent joints.
  // Returns the sign of their determinant.
  function factor(w) {
    loops(w, out);
    let side = 1, largest = 0;
    for (let j = 0; j < k; j++) for (let i = 0, at = k + dependent[j] * k; i < k; i++) {
      const value = LU[i * k + j] = out[at + i] * scale[j];
      if (Math.abs(value) > largest) largest = Math.abs(value);
    }
    for (let i = 0; i < k; i++) order[i] = i;
    for (let c = 0; c < k; c++) {
      let best = c;
      for (let i = c + 1; i < k; i++) if (Math.abs(LU[i * k + c]) > Math.abs(LU[best * k + c])) best = i;
      if (best !== c) {
        for (let j = 0; j < k; j++) {
          const kept = LU[c * k + j]; LU[c * k + j] = LU[best * k + j]; LU[best * k + j] = kept;
        }
        const kept = order[c]; order[c] = order[best]; order[best] = kept; side = -side;
      }
      const pivot = LU[c * k + c];
      if (!(Math.abs(pivot) > SINGULAR * largest)) throw new OutOfReach("the loops have a dead point here");
      if (pivot < 0) side = -side;
      for (let i = c + 1; i < k; i++) {
        const by = LU[i * k + c] /= pivot;
        if (by) for (let j = c + 1; j < k; j++) LU[i * k + j] -= by * LU[c * k + j];
      }
    }
    return side;
  }
  function solve(right) { // −J_D⁻¹ right, for the dependent joints, with the last factors
    for (let i = 0; i < k; i++) {
      x[i] = -right[order[i]];
      for (let j = 0; j < i; j++) x[i] -= LU[i * k + j] * x[j];
    }
    for (let i = k - 1; i >= 0; i--) {
      for (let j = i + 1; j < k; j++) x[i] -= LU[i * k + j] * x[j];
      x[i] /= LU[i * k + i];
    }
    return x.map((v, i) => v * scale[i]);
  }
  function along(rate) { // J_I u̇
    const sums = new Float64Array(k);
    for (let a = 0; a < m; a++) for (let i = 0, at = k + independent[a] * k; i < k; i++)
      sums[i] += out[at + i] * rate[a];
    return sums;
  }
  function follow(step) { // moves the independent joints by a short step
    const side = factor(w), next = w.slice();
    let last = Infinity, now = side, change = solve(along(step));
    independent.forEach((j, a) => { next[j] += step[a]; });
    for (let count = 0; count < 20; count++) {
      dependent.forEach((j, i) => { next[j] += change[i]; });
      const most = change.reduce((most, v, i) => Math.max(most, Math.abs(v) / scale[i]), 0);
      if (!(most < 1)) break;
      if (count > 0 && (most <= 1e-14 || (most < 1e-10 && most >= last))) {
        if (now !== side) break; // the step has passed a dead point
        dependent.forEach((j, i) => {
          if (bounded[i] && (next[j] < low[i] - 1e-9 || next[j] > high[i] + 1e-9))
            throw new OutOfReach(`${names[i]} is at its limit`);
        });
        return next;
      }
      if (count > 0) last = most;
      now = factor(next);
      change = solve(out);
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
    const here = shape(u), wdot = new Array(size).fill(0);
    factor(here);
    const by = solve(along(udot));
    independent.forEach((j, a) => { wdot[j] = udot[a]; });
    dependent.forEach((j, i) => { wdot[j] = by[i]; });
    return [here, wdot];
  }
  return { shape, rates, get state() { return w; }, set state(value) { w = value; } };
}
