// Draw each figure as wide as its place, one panel per row where that is narrow.
{
  const MARGIN = 76;  // of a panel, for the labels of its vertical axis [px]
  const NARROW = 600;  // [px]

  async function unpacked(text) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return JSON.parse(await new Response(stream).text());
  }

  async function draw(figure, margin = MARGIN) {
    const place = figure.querySelector(".chart");
    const room = place.clientWidth;
    if (!room || (room === figure.drawnFor && margin === MARGIN)) return;
    figure.drawnFor = room;
    const spec = await unpacked(figure.querySelector(".specification").textContent);
    const values = figure.querySelector("a.values");
    values.href ||= URL.createObjectURL(new Blob([spec.data.values], { type: "text/csv" }));
    if (room < NARROW) {
      spec.columns = 1;
      Object.assign(spec.config.legend, { columns: 1, labelLimit: room - 120 });
    }
    for (const panel of spec.concat) panel.width = Math.floor(room / spec.columns - margin);
    const actions = { export: true, source: false, compiled: false, editor: false };
    const expressionFunctions = { asText: (text) => String(text) };
    const options = { actions, expressionFunctions, renderer: "canvas", scaleFactor: { png: 2 } };
    await vegaEmbed(place, spec, options);
    const excess = place.querySelector("canvas").offsetWidth - room;
    if (excess > 0 && margin === MARGIN) await draw(figure, margin + excess / spec.columns + 2);
  }

  const all = [...document.querySelectorAll("figure")];
  const drawAll = () => all.forEach((figure) => draw(figure));
  let waiting;
  addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(drawAll, 200); });
  document.querySelectorAll("details.part").forEach((part) => part.addEventListener("toggle", drawAll));
  drawAll();
}
