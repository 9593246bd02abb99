"use strict";
(() => {
  const every = (selector, inside = document) => [...inside.querySelectorAll(selector)];
  const byId = (id) => document.getElementById(id);
  const numbers = (text) => (text || "").split(" ").filter(Boolean);
  const filter = byId("filter");
  const found = byId("found");
  const rows = every("[data-row]");

  // The picture: lines from senders to topics to receivers

  const picture = byId("picture");
  const lines = byId("lines");
  const flows = picture ? every(".flow", picture) : [];
  const chosen = byId("chosen");
  const drawing = (name, attributes, inside) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return inside.appendChild(made);
  };

  const draw = () => {
    if (!picture) return;
    picture.classList.add("drawn");
    lines.replaceChildren();
    const all = picture.getBoundingClientRect();
    if (!all.width || getComputedStyle(lines).display === "none") return;
    for (const side of ["width", "height"]) lines.setAttribute(side, all[side]);
    const marker = drawing("marker", { id: "arrow", viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 8, markerHeight: 8, markerUnits: "userSpaceOnUse", orient: "auto" }, lines);
    drawing("path", { d: "M0 0L8 4L0 8z" }, marker);
    const side = (id) => new Map(every(".box", byId(id)).map((each) => [each.dataset.number, each.getBoundingClientRect()]));
    const [senders, receivers] = [side("senders"), side("receivers")];
    const line = (from, to, number, group) => {
      const [x, y] = [from.right - all.left, from.top + Math.min(from.height / 2, 18) - all.top];
      const [u, v] = [to.left - all.left, to.top + Math.min(to.height / 2, 18) - all.top];
      const middle = (x + u) / 2;
      const path = drawing("path", { d: `M${x} ${y}C${middle} ${y} ${middle} ${v} ${u} ${v}`, "marker-end": "url(#arrow)" }, lines);
      Object.assign(path.dataset, { flow: number, group });
    };
    flows.forEach((flow, number) => {
      if (flow.hidden) return;
      const here = flow.getBoundingClientRect();
      for (const each of numbers(flow.dataset.from)) line(senders.get(each), here, number, each);
      for (const each of numbers(flow.dataset.to)) line(here, receivers.get(each), number, each);
    });
    light();
  };

  let lit = null; // a box that the user points at
  const light = () => {
    const [flow, group] = lit ? [flows.indexOf(lit), lit.dataset.number] : [-1, undefined];
    for (const path of every("path[data-flow]", lines)) {
      const is = lit && (flow < 0 ? path.dataset.group === group : +path.dataset.flow === flow);
      path.classList.toggle("lit", Boolean(is));
      path.classList.toggle("dim", Boolean(lit && !is) || flows[path.dataset.flow].classList.contains("out"));
    }
  };

  const unitIn = (list, name) => { // tb3 of /tb3/camera, in the list of /{name}/camera
    const [before, after] = list.dataset.label.split("{name}");
    return name.slice(before.length, after ? -after.length : undefined);
  };

  const choose = (button) => {
    const off = !button || button.getAttribute("aria-pressed") === "true";
    every("[aria-pressed]", picture).forEach((each) => each.setAttribute("aria-pressed", !off && each.textContent === button.textContent));
    const list = off ? null : button.closest(".members");
    const group = list && list.closest(".box").dataset.number;
    const unit = list && unitIn(list, button.textContent);
    let count = 0;
    for (const flow of flows) {
      const is = off || numbers(flow.dataset.holders).includes(group);
      flow.classList.toggle("out", !is);
      count += is;
      for (const name of every(".topic bdi", flow)) {
        name.dataset.text ??= name.textContent;
        const own = !off && numbers(flow.dataset.own).includes(group);
        name.textContent = own ? name.dataset.text.replaceAll("{name}", unit) : name.dataset.text;
      }
    }
    chosen.textContent = off ? "" : `${button.textContent}: ${count} of ${flows.length} boxes of topics; press it again for all`;
    draw();
  };

  if (picture) {
    for (const details of every("details", picture)) {
      details.addEventListener("toggle", () => {
        for (const name of every(".members bdi", details)) {
          const button = document.createElement("button");
          Object.assign(button, { type: "button", textContent: name.textContent });
          button.setAttribute("aria-pressed", "false");
          name.replaceWith(button);
        }
        draw();
      });
    }
    picture.addEventListener("click", (event) => {
      const button = event.target.closest(".members button");
      if (button) choose(button);
    });
    const point = (event) => { lit = event.target.closest?.(".box"); light(); };
    for (const kind of ["pointerover", "focusin"]) picture.addEventListener(kind, point);
    for (const kind of ["pointerleave", "focusout"]) picture.addEventListener(kind, () => { lit = null; light(); });
    new ResizeObserver(draw).observe(picture);
  }

  // Find, fold and print

  const foldedAs = (wanted) => { // for each group, what stands in its rows for the wanted topic
    const found = new Map();
    for (const list of every(".members")) {
      const units = new Set(every("li", list).map((each) => unitIn(list, each.textContent).toLowerCase()));
      const inside = [...units].filter((unit) => unit && unit !== wanted && wanted.includes(unit));
      if (inside.length) found.set(list.closest(".box").dataset.number, inside.map((unit) => wanted.replaceAll(unit, "{name}")));
    }
    return found;
  };

  const show = () => {
    const wanted = filter.value.trim().toLowerCase();
    const has = (row, text) => text === "" || `${row.textContent} ${row.dataset.words ?? ""}`.toLowerCase().includes(text);
    const groups = new Set(rows.filter((row) => row.dataset.group && has(row, wanted)).map((row) => row.dataset.group));
    const folded = foldedAs(wanted);
    let count = 0;
    for (const row of rows) {
      const match = has(row, wanted) || numbers(row.dataset.holders).some((each) => groups.has(each) || folded.get(each)?.some((text) => has(row, text)));
      row.hidden = !match;
      count += match;
    }
    found.textContent = wanted ? `${count} of ${rows.length} rows` : "";
    draw();
  };

  const fold = (open) => every("details").forEach((each) => { each.open = open; });
  const openTarget = () => {
    const inside = location.hash && byId(decodeURIComponent(location.hash.slice(1)))?.closest("details");
    if (inside) inside.open = true;
  };
  let before = [];
  byId("tools").hidden = false;
  filter.addEventListener("input", show);
  byId("tools").addEventListener("submit", (event) => event.preventDefault());
  byId("unfold").addEventListener("click", () => fold(true));
  byId("fold").addEventListener("click", () => fold(false));
  addEventListener("hashchange", openTarget);
  addEventListener("beforeprint", () => {
    before = every("details:not([data-long]):not([open])");
    before.forEach((each) => { each.open = true; });
  });
  addEventListener("afterprint", () => before.forEach((each) => { each.open = false; }));
  draw();
})();
