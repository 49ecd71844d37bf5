// Pictures of a page for films: the rendered scene and the cards on one canvas that needs no screenshot.
"use strict";
function capture(viewer, draw, robot) { // robot: its joints' groups
  const RADIUS = 6, MARGIN = 6; // corners and shadows of cards, as in style.css [px]
  const canvas = viewer.renderer.domElement, gl = viewer.renderer.getContext();
  const sheet = document.createElement("canvas");
  const pen = sheet.getContext("2d", { alpha: false, willReadFrequently: true });
  const clock = document.getElementById("clock"), style = getComputedStyle(clock);
  const font = `${style.fontWeight} ${style.fontSize} ${style.fontFamily}`, colour = style.color;
  const box = (element) => element.getBoundingClientRect();
  const panel = box(document.getElementById("panel")), bar = box(document.getElementById("bar"));
  const paper = document.querySelector("#panel canvas"), picture = box(paper), words = document.createRange();
  words.selectNodeContents(clock);
  const text = box(words);
  const render = background(viewer, occlusion(viewer, robot)), store = gl.createBuffer();
  let pixels = null, image = null, rendered = null; // time whose scene is in `store`, or will be soon
  function resize() {
    [sheet.width, sheet.height] = [canvas.width, canvas.height];
    pixels = new Uint8Array(4 * canvas.width * canvas.height);
    image = pen.createImageData(canvas.width, canvas.height);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, store);
    gl.bufferData(gl.PIXEL_PACK_BUFFER, pixels.length, gl.STREAM_READ);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
  }
  function startScene(t) { // the renderer works in another process
    draw(t);
    render();
    const { width, height } = canvas;
    if (sheet.width !== width || sheet.height !== height || !image) resize();
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, store);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    gl.flush();
    rendered = t;
  }
  function paintScene() {
    const { width, height } = sheet, row = 4 * width;
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, store);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, pixels);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    for (let k = 0; k < height; k++) // WebGL's first row is the lowest
      image.data.set(pixels.subarray(k * row, (k + 1) * row), (height - 1 - k) * row);
    pen.putImageData(image, 0, 0);
  }
  const cards = new Map();
  function emptyCard(width, height) { // with a margin for the shadow; shadows are slow, so cards are kept
    const key = `${width} ${height}`;
    if (cards.has(key)) return cards.get(key);
    const card = document.createElement("canvas"), full = [width + 2 * MARGIN, height + 2 * MARGIN];
    [card.width, card.height] = full;
    const ink = card.getContext("2d", { willReadFrequently: true });
    const outline = new Path2D(), outside = new Path2D();
    outline.roundRect(MARGIN, MARGIN, width, height, RADIUS);
    outside.rect(0, 0, ...full);
    outside.addPath(outline);
    ink.save();
    ink.clip(outside, "evenodd"); // a card's shadow does not darken the card
    Object.assign(ink, { shadowColor: "rgba(0, 0, 0, .18)", shadowBlur: 4, shadowOffsetY: 1 });
    ink.fill(outline);
    ink.restore();
    ink.fillStyle = "rgba(255, 255, 255, .86)";
    ink.fill(outline);
    cards.set(key, card);
    return card;
  }
  function paintCard(...corners) {
    const [left, top, right, bottom] = corners.map(Math.round); // as browsers do
    pen.drawImage(emptyCard(right - left, bottom - top), left - MARGIN, top - MARGIN);
  }
  function paintPanel() {
    paintCard(panel.left, panel.top, panel.right, panel.bottom);
    pen.imageSmoothingQuality = "low"; // as browsers draw canvases in documents
    pen.drawImage(paper, picture.left, picture.top, picture.width, picture.height);
  }
  function paintClock() { // at the right edge, as wide as its text
    pen.font = font;
    const size = pen.measureText(clock.textContent), padding = text.left - bar.left;
    const left = bar.right - 2 * padding - size.width;
    paintCard(left, bar.top, bar.right, bar.bottom);
    pen.fillStyle = colour;
    const middle = text.top + text.height / 2;
    pen.fillText(clock.textContent, left + padding,
      Math.round(middle + (size.fontBoundingBoxAscent - size.fontBoundingBoxDescent) / 2));
  }
  return (t, next = null) => { // the scene at time `next` is rendered while this picture is encoded and sent
    document.body.hidden = true; // documents on screen are drawn as well, which takes longer
    if (rendered !== t) startScene(t);
    paintScene();
    if (panel.width) paintPanel();
    paintClock();
    rendered = null;
    if (next !== null) startScene(next);
    return sheet.toDataURL("image/png");
  };
}
