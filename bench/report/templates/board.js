"use strict";
// Tables are sorted, filtered and exported by DataTables. The address keeps what the boards show
// (#task=circle&N=3&sort=method:asc), so a link leads to it. Without scripts all rows are there.
DataTable.ext.errMode = "throw";
const bare = { topStart: null, topEnd: null, bottomStart: null, bottomEnd: null };
for (const table of document.querySelectorAll("table.sortable")) {
  new DataTable(table, { paging: false, autoWidth: false, order: [], layout: bare });
}
const boardTables = [...document.querySelectorAll("table.board")];
const boards = boardTables.map((table) => new DataTable(table, {
  paging: false,
  autoWidth: false,
  order: [],
  layout: {
    ...bare,
    topStart: "info",
    topEnd: { buttons: [{ extend: "csv", text: "Download CSV", filename: table.dataset.name }] },
  },
  language: { info: "rows: _TOTAL_", infoEmpty: "rows: 0", infoFiltered: "of _MAX_" },
}));
const headingsOf = new Map(boards.map((board) => [board, board.columns().header().toArray()]));
const titleOf = (heading) => (heading.querySelector(".dt-column-title") ?? heading).textContent.trim();
const columnOf = (board, name) => headingsOf.get(board).findIndex((h) => titleOf(h) === name);
const filters = document.getElementById("filters");
let following = false;

function boardAddress() {
  const kept = new URLSearchParams([...new FormData(filters)].filter(([, value]) => value !== ""));
  const [index, direction] = boards[0]?.order()[0] ?? [];
  if (direction) kept.set("sort", `${titleOf(headingsOf.get(boards[0])[index])}:${direction}`);
  return location.pathname + location.search + (kept.size ? `#${kept}` : "");
}
function show() {
  const all = filters.elements.columns.checked;
  for (const board of boards) {
    for (const select of filters.querySelectorAll("select")) {
      const index = columnOf(board, select.name);
      if (index >= 0) board.column(index).search(select.value, { exact: true });
    }
    headingsOf.get(board).forEach((heading, i) => {
      if ("extra" in heading.dataset) board.column(i).visible(all, false);
    });
    board.draw();
  }
}
function keepAddress() {
  if (!following) history.replaceState(null, "", boardAddress());
}
function followBoard() {
  const asked = new URLSearchParams(location.hash.slice(1));
  following = true; // what is drawn now must not overwrite the address, such as that of a run
  if (location.hash.includes("=")) {
    for (const select of filters.querySelectorAll("select")) {
      select.value = asked.get(select.name) ?? "";
      if (select.selectedIndex < 0) select.value = "";
    }
    filters.elements.columns.checked = asked.get("columns") === "all";
    const [name, direction] = (asked.get("sort") ?? "").split(/:(?=asc$|desc$)/);
    const index = boards.length ? columnOf(boards[0], name) : -1;
    if (index >= 0) boards[0].order([index, direction]);
  }
  show();
  following = false;
}
filters.hidden = boards.length === 0;
filters.addEventListener("change", () => { show(); keepAddress(); });
filters.addEventListener("reset", () => setTimeout(() => {
  boards.forEach((board) => board.order([]));
  show();
  keepAddress();
}));
boards[0]?.on("order", keepAddress);
window.addEventListener("hashchange", () => location.hash.includes("=") && followBoard());
followBoard();
