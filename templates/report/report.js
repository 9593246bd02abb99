"use strict";
(() => {
  const every = (selector) => [...document.querySelectorAll(selector)];
  const filter = document.getElementById("filter");
  const found = document.getElementById("found");
  const rows = every("[data-row]");

  const show = () => {
    const wanted = filter.value.trim().toLowerCase();
    const has = (row) => wanted === "" || row.textContent.toLowerCase().includes(wanted);
    const groups = new Set(rows.filter((row) => row.dataset.group && has(row)).map((row) => row.dataset.group));
    let count = 0;
    for (const row of rows) {
      const holders = (row.dataset.holders || "").split(" ");
      const match = has(row) || holders.some((each) => groups.has(each));
      row.hidden = !match;
      count += match;
    }
    found.textContent = wanted ? `${count} of ${rows.length} rows` : "";
  };

  const fold = (open) => every("details").forEach((each) => { each.open = open; });
  let before = [];
  document.getElementById("tools").hidden = false;
  filter.addEventListener("input", show);
  document.getElementById("unfold").addEventListener("click", () => fold(true));
  document.getElementById("fold").addEventListener("click", () => fold(false));
  addEventListener("beforeprint", () => {
    before = every("details:not([data-long]):not([open])");
    before.forEach((each) => { each.open = true; });
  });
  addEventListener("afterprint", () => before.forEach((each) => { each.open = false; }));
})();
