"use strict";
(() => {
  // tables: a heading's button sorts by its column; numbers behind data-sort, open ones last
  const key = (row, column) => {
    const cell = row.cells[column];
    const value = cell.dataset.sort;
    if (value === undefined) return cell.classList.contains("number") ? null : cell.textContent.trim();
    return value === "" || isNaN(value) ? value : Number(value);
  };
  const compare = (a, b) =>
    typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
  for (const table of document.querySelectorAll("table.sortable")) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const body = table.tBodies[0];
      const rows = [...body.rows].map((row, index) => ({ row, index, key: key(row, column) }));
      rows.sort((a, b) => {
        if (a.key === null || b.key === null) return (a.key === null) - (b.key === null) || a.index - b.index;
        return (down ? -1 : 1) * compare(a.key, b.key) || a.index - b.index;
      });
      body.append(...rows.map((one) => one.row));
    }));
  }

  // what a link leads to is opened
  const open = () => {
    const there = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!there) return;
    for (let one = there.querySelector("details.part") || there; one; one = one.parentElement) if (one.tagName === "DETAILS") one.open = true;
    there.scrollIntoView();
  };
  addEventListener("hashchange", open);
  open();

  // on paper nothing can be opened
  let closed = [];
  addEventListener("beforeprint", () => {
    closed = [...document.querySelectorAll("details:not([open])")];
    for (const one of closed) one.open = true;
  });
  addEventListener("afterprint", () => { for (const one of closed) one.open = false; });
})();
