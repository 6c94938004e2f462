const page = id => document.getElementById(id), every = words => [...document.querySelectorAll(words)];
const viewer = page("viewer");
// an attribute that ends in .hdr is what tells the viewer the kind of file
for (const radio of every("input[name=light]")) radio.onchange = () => viewer.setAttribute("environment-image", radio.value);
viewer.addEventListener("error", () => { page("no-viewer").hidden = false; });
for (const range of every(".wipe input")) range.oninput = () => range.parentElement.style.setProperty("--at", range.value + "%");
const zooms = every(".grid button"), shown = new Map(zooms.map(zoom => [zoom.dataset.kind + zoom.dataset.view, zoom.firstElementChild.src]));
const show = view => {
  for (const wipe of every(".wipe")) {
    const [before, after] = wipe.querySelectorAll("img"), other = shown.get(wipe.dataset.kind + view);
    wipe.closest("figure").hidden = !other;
    before.src = shown.get("photograph" + view);
    after.src = other || before.src;
  }
};
for (const radio of every("input[name=view]")) radio.onchange = () => show(radio.value);
if (page("view-0")) show("0");
const large = page("large");
let current = 0;
const enlarge = index => {
  current = (index + zooms.length) % zooms.length;
  page("large-picture").src = zooms[current].firstElementChild.src;
  page("large-picture").alt = page("large-name").textContent = zooms[current].firstElementChild.alt;
};
zooms.forEach((zoom, index) => { zoom.onclick = () => { enlarge(index); large.showModal(); }; });
page("before").onclick = () => enlarge(current - 1);
page("after").onclick = () => enlarge(current + 1);
page("close").onclick = () => large.close();
large.onkeydown = event => {
  if (event.key === "ArrowLeft") enlarge(current - 1);
  if (event.key === "ArrowRight") enlarge(current + 1);
};
large.onclick = event => { if (event.target === large) large.close(); };
large.onclose = () => zooms[current].focus();
