// Details of one run in a dialog. The address names it (#run-17), so links and "back" work; without
// scripts the same links lead to the run's row. Texts are set as text, never as HTML.
const runDialog = document.getElementById("run");
const runReplay = new Replay(runDialog.querySelector("[data-replay]"));
let runDetails = null;
let runShown = -1;

function allDetails() {
  runDetails ??= JSON.parse(document.getElementById("details").textContent);
  return runDetails;
}
function element(tag, text, attributes = {}) {
  const made = document.createElement(tag);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}
function setText(id, text) {
  const found = document.getElementById(id);
  found.textContent = text;
  found.hidden = text === "";
}
function showCurve(curve) {
  const plot = document.getElementById("run-curve");
  plot.hidden = !curve;
  document.getElementById("run-no-curve").hidden = Boolean(curve);
  if (!curve) return;
  const known = curve.reward.filter((y) => y !== null);
  const [low, high, last] = [Math.min(...known), Math.max(...known), curve.epoch.at(-1)];
  const place = (x, y) => `${(900 * x / (last || 1)).toFixed(1)} ${(220 * (high - y) / (high - low || 1)).toFixed(1)}`;
  let line = "", pen = "M";
  curve.reward.forEach((y, i) => {
    if (y !== null) line += pen + place(curve.epoch[i], y);
    pen = y === null ? "M" : "L";
  });
  plot.innerHTML = '<svg viewBox="-4 -4 908 228" preserveAspectRatio="none"><path/></svg>';
  plot.querySelector("path").setAttribute("d", line);
  const ends = document.createElement("p");
  ends.textContent = `Training return from ${low} to ${high} (height) over ${curve.epochs} epochs (width).`;
  plot.append(ends);
}
function showRun(index) {
  const run = allDetails()[index];
  runShown = index;
  setText("run-title", run.run);
  const facts = { method: run.method, task: run.task, drones: run.team_size, seed: run.seed, status: run.status };
  document.getElementById("run-facts").replaceChildren(...Object.entries(facts).map(([name, value]) => {
    const pair = document.createElement("div");
    pair.append(element("dt", name), element("dd", value));
    return pair;
  }));
  document.getElementById("run-seeds").replaceChildren(...run.seeds.map((i) => {
    const item = document.createElement("li");
    const here = i === index ? { "aria-current": "true" } : {};
    item.append(element("a", `seed ${allDetails()[i].seed}`, { href: `#run-${i}`, ...here }));
    return item;
  }));
  setText("run-cause", run.cause);
  document.getElementById("run-metrics").replaceChildren(...run.metrics.map(([name, value, unit]) => {
    const row = document.createElement("tr");
    row.append(element("th", name, { scope: "row" }), element("td", value), element("td", unit, { class: "text" }));
    return row;
  }));
  for (const part of ["settings", "versions"]) {
    setText(`run-${part}`, document.getElementById(run[part]).textContent);
  }
  if (!runDialog.open) runDialog.showModal();
  runDialog.scrollTop = 0;
  runReplay.root.hidden = !run.flight;
  document.getElementById("run-no-flight").hidden = Boolean(run.flight);
  if (run.flight) runReplay.show(run.flight);
  else runReplay.stop();
  showCurve(run.curve);
}
function followAddress() {
  const index = /^#run-(\d+)$/.exec(location.hash)?.[1];
  if (index !== undefined && Number(index) < allDetails().length) showRun(Number(index));
  else if (runDialog.open) runDialog.close();
}
window.addEventListener("hashchange", followAddress);
document.getElementById("run-close").addEventListener("click", () => runDialog.close());
runDialog.addEventListener("close", () => {
  runReplay.stop();
  // By now a link may have asked for another run.
  if (location.hash === `#run-${runShown}`) history.replaceState(null, "", boardAddress());
});
followAddress();
