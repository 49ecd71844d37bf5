// Unpacks the viewer and the arrays of a page, and then starts the page's program.
"use strict";
(async () => {
  const text = (id) => document.getElementById(id).textContent;
  async function unpack(id) {
    const packed = Uint8Array.from(atob(text(id)), (c) => c.charCodeAt(0));
    return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
  }
  function start(code) {
    document.body.append(Object.assign(document.createElement("script"), { textContent: code }));
  }
  if (typeof DecompressionStream === "undefined") {
    document.body.prepend("This page needs a browser of 2023 or later.");
    return;
  }
  const [viewer, blob] = await Promise.all(["viewer", "blob"].map(unpack));
  window.pinredBlob = blob;
  start(new TextDecoder().decode(viewer));
  start(text("program"));
})();
