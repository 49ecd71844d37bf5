// Clears the rows of the background instead of drawing it: a software renderer samples its texture at each pixel.
"use strict";
function background(viewer, render) { // return a function that renders a picture with the same pixels as `render`
  const { renderer, scene, camera } = viewer, gl = renderer.getContext(), { Color } = MeshCat.THREE;
  let bands = [], height = 0; // bands: first row, number of rows, colour
  function findBands() {
    const visible = scene.children.map((child) => child.visible), rows = gl.drawingBufferHeight;
    const column = new Uint8Array(4 * rows); // the colour of a row is constant
    for (const child of scene.children) child.visible = false;
    renderer.render(scene, camera);
    scene.children.forEach((child, i) => { child.visible = visible[i]; });
    gl.readPixels(0, 0, 1, rows, gl.RGBA, gl.UNSIGNED_BYTE, column);
    bands = [];
    for (let y = 0; y < rows; y++) {
      const colour = [0, 1, 2].map((i) => column[4 * y + i]), key = String(colour), last = bands[bands.length - 1];
      if (last && last.key === key) last.rows++;
      else bands.push({ y, rows: 1, key, colour: new Color(...colour.map((value) => value / 255)) });
    }
    height = rows;
  }
  return () => {
    if (height !== gl.drawingBufferHeight) findBands();
    const picture = scene.background, colour = renderer.getClearColor(new Color()), alpha = renderer.getClearAlpha();
    const width = gl.drawingBufferWidth, ratio = renderer.getPixelRatio();
    renderer.clear(false, true, true);
    renderer.setScissorTest(true);
    for (const band of bands) {
      renderer.setScissor(0, band.y / ratio, width / ratio, band.rows / ratio);
      renderer.setClearColor(band.colour, 1);
      renderer.clear(true, false, false);
    }
    renderer.setScissorTest(false);
    renderer.autoClear = false;
    scene.background = null;
    render();
    scene.background = picture;
    renderer.autoClear = true;
    renderer.setClearColor(colour, alpha);
  };
}
