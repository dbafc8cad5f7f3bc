"use strict";
// Sorting: a click on a heading sorts its table, a second click reverses. Empty cells stay last.
function cellOrder(row, index) {
  const cell = row.cells[index];
  const text = cell.dataset.order ?? cell.textContent.trim();
  return text === "-" ? "" : text;
}
function sortTable(table, index, descending) {
  const body = table.tBodies[0];
  const rows = Array.from(body.rows, (row) => ({ row, key: cellOrder(row, index) }));
  const filled = rows.filter((r) => r.key !== "");
  const numeric = filled.every((r) => !Number.isNaN(parseFloat(r.key)));
  const sign = descending ? -1 : 1;
  filled.sort((a, b) =>
    sign * (numeric ? parseFloat(a.key) - parseFloat(b.key)
                    : a.key.localeCompare(b.key, "en", { numeric: true })));
  const empty = rows.filter((r) => r.key === "");
  body.append(...filled.concat(empty).map((r) => r.row));
}
for (const table of document.querySelectorAll("table.sortable")) {
  const headings = Array.from(table.tHead.rows[0].cells);
  headings.forEach((heading, index) => heading.querySelector("button").addEventListener("click", () => {
    const descending = heading.getAttribute("aria-sort") === "ascending";
    headings.forEach((other) => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
    sortTable(table, index, descending);
  }));
}
