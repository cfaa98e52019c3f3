"use strict";
document.documentElement.classList.add("scripted");
const number = (text) => (text !== "" && Number.isFinite(Number(text)) ? Number(text) : null);
function less(a, b) {
  const x = number(a), y = number(b);
  if (x !== null && y !== null) return x - y;
  if (x !== null || y !== null) return x !== null ? -1 : 1;
  return a.localeCompare(b);
}
for (const head of document.querySelectorAll("table.sortable thead th")) {
  head.addEventListener("click", () => {
    const place = head.cellIndex, body = head.closest("table").tBodies[0];
    const up = head.getAttribute("aria-sort") === "descending";
    for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const key = (row) => row.cells[place].dataset.key ?? row.cells[place].textContent;
    const rows = [...body.rows].sort((a, b) => (up ? 1 : -1) * less(key(a), key(b)));
    body.append(...rows);
  });
}
const list = document.getElementById("failures-list");
if (list) {
  const failures = [...list.querySelectorAll(".failure")];
  const filters = [...document.querySelectorAll("[data-filter]")];
  const sift = () => {
    let left = 0;
    for (const each of failures) {
      const fits = filters.every((f) => f.value === "" || each.dataset[f.dataset.filter] === f.value);
      each.hidden = !fits;
      left += fits;
    }
    document.getElementById("failures-count").textContent = `${left} of ${failures.length} ${failures.length === 1 ? "failure" : "failures"}`;
  };
  for (const each of filters) each.addEventListener("change", sift);
  let sorted = "", up = true;
  for (const button of list.querySelectorAll("[data-sort]")) {
    button.addEventListener("click", () => {
      const name = button.dataset.sort;
      up = sorted === name ? !up : name !== "speed";
      sorted = name;
      const key = (each) => each.dataset[name];
      list.append(...failures.sort((a, b) => (up ? 1 : -1) * less(key(a), key(b)) || a.dataset.number - b.dataset.number));
    });
  }
  const open = () => {
    const place = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const found = place && place.closest("details");
    if (found) {
      found.hidden = false;
      found.open = true;
      place.scrollIntoView();
    }
  };
  addEventListener("hashchange", open);
  open();
}
