// Sorting and filtering of the leaderboard, and links that open what they lead to.
(() => {
  "use strict";
  document.documentElement.classList.add("js");
  const say = text => { document.getElementById("board-status").textContent = text; };

  // The first click puts the best value first; where a value is aimed at, that is the nearest to it.
  function sortBy(table, column) {
    const heads = [...table.tHead.rows[0].cells];
    const head = heads[column];
    const { direction, target } = head.dataset;
    const value = row => Number(row.cells[column].dataset.value || NaN);
    const keys = direction === "target" && target
      ? row => Math.abs(value(row) - Number(target))
      : value;
    const words = direction === "target" && target ? ["other", "descending"]
      : direction === "higher" ? ["descending", "ascending"] : ["ascending", "descending"];
    const before = head.getAttribute("aria-sort");
    const now = before === words[0] ? words[1] : words[0];
    const sign = now === "descending" ? -1 : 1;
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", now);
    const body = table.tBodies[0];
    const compare = column === 0
      ? (a, b) => sign * a.cells[0].textContent.localeCompare(b.cells[0].textContent)
      : (a, b) => {
        const x = keys(a), y = keys(b);
        // Rows without a value stay last whichever way is up.
        if (isNaN(x) || isNaN(y)) return isNaN(x) - isNaN(y);
        return sign * (x - y);
      };
    [...body.rows].sort(compare).forEach(row => body.append(row));
    const order = now === words[0] && column && direction !== "none" ? "best first" : now;
    say(`Sorted by ${head.querySelector(".sort").textContent.trim()}, ${order}.`);
  }

  for (const table of document.querySelectorAll("table.sortable")) {
    [...table.tHead.rows[0].cells].forEach((head, column) =>
      head.querySelector(".sort").addEventListener("click", () => sortBy(table, column)));
  }

  const boards = [...document.querySelectorAll(".board")];
  const chosen = name => document.querySelector(`input[name="${name}"]:checked`)?.value;
  const task = document.getElementById("board-task");
  function filter() {
    const group = chosen("board-group") ?? "*";
    const variant = chosen("board-variant");
    for (const board of boards) {
      board.hidden = (group !== "*" && board.dataset.group !== group)
        || (variant !== undefined && board.dataset.variant !== variant)
        || (task !== null && board.dataset.task !== task.value);
    }
  }
  for (const control of document.querySelectorAll(".filters input, .filters select")) {
    control.addEventListener("change", () => {
      filter();
      say(`${boards.filter(board => !board.hidden).length} tables shown.`);
    });
  }
  if (boards.length) filter();

  // A link into something folded opens it.
  function open() {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let folded = target.closest("details"); folded; folded = folded.parentElement.closest("details")) folded.open = true;
    target.scrollIntoView();
  }
  addEventListener("hashchange", open);
  // A second click on the same link changes no hash.
  document.addEventListener("click", event => {
    if (event.target.closest?.("a.what")) setTimeout(open);
  });
  open();

  // Paper shows what is folded too.
  let folded = [];
  addEventListener("beforeprint", () => {
    folded = [...document.querySelectorAll("details:not([open])")];
    for (const part of folded) part.open = true;
  });
  addEventListener("afterprint", () => { for (const part of folded) part.open = false; });
})();
