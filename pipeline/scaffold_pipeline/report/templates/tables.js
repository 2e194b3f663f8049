"use strict";
// Tables that sort by a click on a title, or by Enter on it: numbers by size, all else by letter, empty cells last.

function compare(a, b) {
  if (typeof a === "number" && typeof b === "number") return a - b;
  return String(a).localeCompare(String(b), undefined, { numeric: true });
}

// `valueOf(row, column)` is what a row is sorted by. Returns the rows, kept in the order that is shown.
function makeSortable(table, valueOf) {
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const heads = [...table.tHead.rows[0].cells];
  const isEmpty = (value) => value === null || value === "";
  const sortBy = (column) => {
    const down = heads[column].getAttribute("aria-sort") === "ascending";
    heads.forEach((head) => head.removeAttribute("aria-sort"));
    heads[column].setAttribute("aria-sort", down ? "descending" : "ascending");
    const keyed = rows.map((row) => [row, valueOf(row, column)]);
    keyed.sort(([, a], [, b]) => isEmpty(a) - isEmpty(b) || compare(a, b) * (down ? -1 : 1));
    rows.splice(0, rows.length, ...keyed.map(([row]) => row)); // what was equal keeps its order
    body.append(...rows);
  };
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    button.addEventListener("click", () => sortBy(column));
    head.append(button);
  });
  return rows;
}

// A cell that shows a number in words carries it, <td data-value="12.5">, or nothing where it has none.
function valueOfCell(row, column) {
  const cell = row.cells[column];
  const value = cell.dataset.value;
  return value === undefined ? cell.textContent.trim() : value && Number(value);
}

document.querySelectorAll("table.sortable").forEach((table) => makeSortable(table, valueOfCell));
