// Leaves out the triangles of a robot that no sample of a picture shows. A software renderer spends most of its
// time on them: of a detailed robot, nine in ten are hidden, turned away, or fall between all samples.
"use strict";
function occlusion(viewer, robot) { // robot: groups of meshes; return a function that renders a picture
  // These numbers are those of SwiftShader; other renderers draw all triangles.
  const GRID = 16; // corners are rounded to a sixteenth of a pixel
  const SAMPLES = [0.375, 0.875, 0.125, 0.625]; // x of the samples of a pixel, whose y is 1/8, 3/8, 5/8, 7/8
  const NEAR = 1 + 1e-4; // triangles whose distances differ by this ratio do not hide each other
  const MOST = 16; // number of pixels; triangles on more of them are not compared with whole pixels
  const { renderer, scene, camera, controls } = viewer, gl = renderer.getContext();
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  const name = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  if (!name.includes("SwiftShader") || gl.getParameter(gl.SAMPLES) !== SAMPLES.length
    || 2 ** gl.getParameter(gl.SUBPIXEL_BITS) !== GRID) return () => viewer.render();
  const { Matrix4, BufferGeometry, BufferAttribute, DynamicDrawUsage } = MeshCat.THREE;
  const parts = [], matrix = new Matrix4();
  let corners = 0, triangles = 0;
  for (const group of robot) group.traverse((mesh) => {
    if (!mesh.isMesh || mesh.material.transparent) return;
    const whole = mesh.geometry, part = new BufferGeometry(), index = whole.index.array;
    for (const key in whole.attributes) part.setAttribute(key, whole.attributes[key]);
    part.setIndex(new BufferAttribute(new Uint32Array(index.length), 1).setUsage(DynamicDrawUsage));
    whole.computeBoundingSphere();
    part.boundingSphere = whole.boundingSphere;
    parts.push({ mesh, whole, part, index, corner: corners, triangle: triangles });
    corners += whole.attributes.position.count;
    triangles += index.length / 3;
  });
  const faces = new Int32Array(3 * triangles), seen = new Uint8Array(triangles).fill(1), fresh = new Uint8Array(triangles);
  for (const { index, corner, triangle } of parts)
    index.forEach((value, i) => { faces[3 * triangle + i] = value + corner; });
  const X = new Float32Array(corners), Y = new Float32Array(corners), D = new Float32Array(corners);
  let width = 0, height = 0, depths = null, lows = null; // D and depths are 1 / distance; 0 is nothing

  let box = null; // of the robot: first and end column, first and end row [px]
  function project() { // corners to pixels
    let left = width, right = 0, low = height, high = 0;
    controls.update(); // as before each picture
    camera.updateProjectionMatrix();
    scene.updateMatrixWorld();
    for (const { mesh, whole, corner } of parts) {
      matrix.multiplyMatrices(camera.matrixWorldInverse, mesh.matrixWorld);
      const m = matrix.premultiply(camera.projectionMatrix).elements;
      const at = whole.attributes.position.array, count = at.length / 3;
      for (let i = 0, k = corner; i < count; i++, k++) {
        const x = at[3 * i], y = at[3 * i + 1], z = at[3 * i + 2];
        const w = m[3] * x + m[7] * y + m[11] * z + m[15], d = w > camera.near ? 1 / w : NaN;
        const across = ((m[0] * x + m[4] * y + m[8] * z + m[12]) * d + 1) * width / 2;
        const up = ((m[1] * x + m[5] * y + m[9] * z + m[13]) * d + 1) * height / 2;
        X[k] = Math.floor(GRID * across + 0.5) / GRID;
        Y[k] = Math.floor(GRID * up + 0.5) / GRID;
        D[k] = d;
        if (X[k] < left) left = X[k];
        if (X[k] > right) right = X[k];
        if (Y[k] < low) low = Y[k];
        if (Y[k] > high) high = Y[k];
      }
    }
    box = { left: Math.max(0, Math.floor(left) - 1), right: Math.min(width, Math.ceil(right) + 2),
      low: Math.max(0, Math.floor(low) - 1), high: Math.min(height, Math.ceil(high) + 2) };
  }
  const least = (a, b, c) => a < b ? (a < c ? a : c) : (b < c ? b : c); // faster than Math.min
  const most = (a, b, c) => a > b ? (a > c ? a : c) : (b > c ? b : c);
  // Store the depths of a triangle at the samples that it covers, or return whether it may be seen there. The
  // renderer takes the depth on either side of the middle of a pixel: store the farthest, compare the nearest.
  function visit(f, stores) {
    const p = faces[3 * f], q = faces[3 * f + 1], r = faces[3 * f + 2];
    const x0 = X[p], x1 = X[q], x2 = X[r], y0 = Y[p], y1 = Y[q], y2 = Y[r], d0 = D[p], d1 = D[q], d2 = D[r];
    const u1 = x1 - x0, u2 = x2 - x1, u0 = x0 - x2, v1 = y1 - y0, v2 = y2 - y1, v0 = y0 - y2;
    const area = v1 * u0 - u1 * v0;
    if (area === 0) return false;
    if (Number.isNaN(area)) return !stores; // reaches behind the camera
    const turn = area > 0 ? 1 : -1;
    const left = least(x0, x1, x2), right = most(x0, x1, x2);
    const low = least(y0, y1, y2), high = most(y0, y1, y2);
    const first = Math.max(0, Math.ceil(4 * low - 0.5)), end = Math.min(4 * height, Math.ceil(4 * high - 0.5));
    if (first >= end) return false;
    const across = ((d0 - d1) * v0 - (d2 - d0) * v1) / area, up = ((d2 - d0) * u1 + (d1 - d0) * u0) / area;
    const steep = Math.abs(across);
    if (!stores && isBehindPixels(left, right, low, high, (most(d0, d1, d2) + steep) * NEAR)) return false;
    const s1 = v1 ? u1 / v1 : 0, s2 = v2 ? u2 / v2 : 0, s0 = v0 ? u0 / v0 : 0;
    const side1 = turn * v1, side2 = turn * v2, side0 = turn * v0; // positive: the right end of a row
    for (let j = first; j < end; j++) {
      const y = (j + 0.5) / 4, shift = SAMPLES[j & 3];
      const e1 = x0 + (y - y0) * s1, e2 = x1 + (y - y1) * s2, e0 = x2 + (y - y2) * s0;
      let l = left, h = right;
      if (side1 > 0) { if (e1 < h) h = e1; } else if (side1 < 0 && e1 > l) l = e1;
      if (side2 > 0) { if (e2 < h) h = e2; } else if (side2 < 0 && e2 > l) l = e2;
      if (side0 > 0) { if (e0 < h) h = e0; } else if (side0 < 0 && e0 > l) l = e0;
      const from = Math.max(0, Math.ceil(l - shift)), to = Math.min(width, Math.ceil(h - shift));
      if (from >= to) continue;
      let d = d0 + across * (from + 0.5 - x0) + up * (y - y0), at = j * width + from;
      const last = at + to - from, away = steep * Math.abs(shift - 0.5);
      if (stores) {
        for (d -= away; at < last; at++, d += across) if (d > depths[at]) depths[at] = d;
      } else {
        for (d += away; at < last; at++, d += across) if (d * NEAR >= depths[at]) return true;
      }
    }
    return false;
  }
  function isBehindPixels(left, right, low, high, nearest) { // faster than to compare with all samples
    const x = Math.floor(left), y = Math.floor(low), w = Math.floor(right) - x + 1, h = Math.floor(high) - y + 1;
    if (!(x >= 0 && y >= 0 && x + w <= width && y + h <= height && w * h <= MOST)) return false;
    for (let row = y * width + x; row < (y + h) * width; row += width)
      for (let k = row; k < row + w; k++) if (!(nearest < lows[k])) return false;
    return true;
  }
  function findFarthest() { // the farthest depth of each pixel
    for (let row = box.low; row < box.high; row++)
      for (let k = row * width + box.left, s = k + 3 * row * width, end = row * width + box.right; k < end; k++, s++) {
        const a = depths[s], b = depths[s + width], c = least(depths[s + 2 * width], depths[s + 3 * width], a);
        lows[k] = b < c ? b : c;
      }
  }
  function findSeen() {
    for (let j = 4 * box.low; j < 4 * box.high; j++) depths.fill(0, j * width + box.left, j * width + box.right);
    // What the last picture showed hides most of the rest. Hiding less only draws more.
    for (let f = 0; f < triangles; f++) if (seen[f]) visit(f, true);
    findFarthest();
    for (let f = 0; f < triangles; f++) {
      const before = seen[f];
      seen[f] = visit(f, false) ? 1 : 0;
      fresh[f] = seen[f] && !before ? 1 : 0;
    }
    for (let f = 0; f < triangles; f++) if (fresh[f]) visit(f, true);
    for (let f = 0; f < triangles; f++) if (seen[f]) seen[f] = visit(f, false) ? 1 : 0;
  }
  // Render a picture. Few pixels, if any, differ from a picture with all triangles: visit() computes more precisely.
  return () => {
    if (gl.drawingBufferWidth !== width || gl.drawingBufferHeight !== height) {
      [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
      depths = new Float32Array(4 * width * height);
      lows = new Float32Array(width * height);
    }
    project();
    findSeen();
    for (const { mesh, part, index, triangle } of parts) {
      const kept = part.index.array;
      let count = 0;
      for (let i = 0, f = triangle; i < index.length; i += 3, f++) {
        if (!seen[f]) continue;
        kept[count++] = index[i];
        kept[count++] = index[i + 1];
        kept[count++] = index[i + 2];
      }
      part.setDrawRange(0, count);
      Object.assign(part.index, { needsUpdate: true, updateRange: { offset: 0, count } });
      mesh.geometry = part;
    }
    viewer.render();
    for (const { mesh, whole } of parts) mesh.geometry = whole;
  };
}
