"use strict";
// Every column sorts: a first click by rising values, a second by falling ones. Numbers are sorted
// as numbers, also those that are printed with a mark or a unit; cells without a value come last.

function value(cell) {
  const text = cell.textContent.trim();
  const number = parseFloat(text.replace(/^[<>~≤≥±\s]+/, "").replace(/^inf/, "Infinity"));
  return { text, number };
}

function compare(one, other) {
  if (!isNaN(one.number) && !isNaN(other.number) && one.number !== other.number) {
    return one.number - other.number;
  }
  return one.text.localeCompare(other.text, undefined, { numeric: true });
}

function sort(head, column) {
  const rising = head.getAttribute("aria-sort") !== "ascending";
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", rising ? "ascending" : "descending");
  const body = head.closest("table").tBodies[0];
  const rows = [...body.rows].map((row) => ({ row, ...value(row.cells[column]) }));
  const filled = rows.filter((entry) => entry.text);
  filled.sort((one, other) => (rising ? compare(one, other) : compare(other, one)));
  for (const entry of [...filled, ...rows.filter((entry) => !entry.text)]) body.append(entry.row);
}

for (const table of document.querySelectorAll("table")) {
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.textContent = head.textContent;
    button.title = "sort by this column";
    button.onclick = () => sort(head, column);
    head.replaceChildren(button);
  });
}

const root = document.documentElement;
document.getElementById("theme").onclick = () => {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const now = root.dataset.theme || (dark ? "dark" : "light");
  root.dataset.theme = now === "dark" ? "light" : "dark";
};
