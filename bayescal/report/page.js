"use strict";
(() => {
const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const make = (tag, properties, ...children) => {
  const one = Object.assign(document.createElement(tag), properties);
  one.append(...children);
  return one;
};

// --- tables ---
const FEWEST = 8;
const rowsOf = (table) => all("tbody tr", table).filter((row) => !row.classList.contains("section"));
const textOf = (cell) => (cell ? cell.innerText ?? cell.textContent : "").replace(/\s+/g, " ").trim();

function readNumber(text) {
  const powers = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const plain = text.replace(/−/g, "-").replace(/(\d),(?=\d{3})/g, "$1");
  const found = plain.match(/^[<>≤≥~≈+\s]*((?=10[⁻⁰¹²³⁴-⁹])|-?∞|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?:·?10([⁻⁰¹²³⁴-⁹]+))?/);
  if (!found || !found[0].trim()) return NaN;
  const base = found[1] === "" ? 1 : found[1].includes("∞") ? (found[1][0] === "-" ? -Infinity : Infinity) : Number(found[1]);
  const power = [...(found[2] ?? "")].map((c) => (c === "⁻" ? "-" : powers.indexOf(c))).join("");
  return base * 10 ** Number(power || 0);
}

function spreadSpans(table) {  // a cell over several rows becomes a cell in each, so that rows can move alone
  for (const cell of all("tbody td[rowspan]", table)) {
    const row = cell.parentNode, column = [...row.cells].indexOf(cell);
    let next = row;
    for (let k = cell.rowSpan; k > 1 && (next = next.nextElementSibling); k--) {
      next.insertBefore(cell.cloneNode(true), next.cells[column] ?? null).removeAttribute("rowspan");
    }
    cell.removeAttribute("rowspan");
  }
}

function sortTable(table, heading, column) {
  const down = heading.getAttribute("aria-sort") === "ascending";
  all("th[aria-sort]", table).forEach((one) => one.removeAttribute("aria-sort"));
  heading.setAttribute("aria-sort", down ? "descending" : "ascending");
  spreadSpans(table);
  const rows = rowsOf(table), texts = new Map(rows.map((row) => [row, textOf(row.cells[column])]));
  const numbers = new Map(rows.map((row) => [row, readNumber(texts.get(row))]));
  const numeric = rows.filter((row) => !Number.isNaN(numbers.get(row))).length * 2 > rows.length;
  const sign = down ? -1 : 1;
  const compare = (a, b) => {
    if (!numeric) return sign * texts.get(a).localeCompare(texts.get(b), "en", { numeric: true });
    const [x, y] = [numbers.get(a), numbers.get(b)];
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
    return x === y ? 0 : sign * (x < y ? -1 : 1);
  };
  for (const body of table.tBodies) {  // each section within itself
    const parts = [[null, []]];
    for (const row of [...body.rows]) row.classList.contains("section") ? parts.push([row, []]) : parts.at(-1)[1].push(row);
    for (const [title, members] of parts) body.append(...(title ? [title] : []), ...members.sort(compare));
  }
}

function filterTable(table, words, count) {
  spreadSpans(table);
  const wanted = words.toLowerCase().split(/\s+/).filter(Boolean);
  let seen = 0;
  for (const row of rowsOf(table)) {
    const text = row.textContent.toLowerCase();
    row.hidden = !wanted.every((word) => text.includes(word));
    seen += !row.hidden;
  }
  for (const title of all("tr.section", table)) {
    let next = title.nextElementSibling, any = false;
    for (; next && !next.classList.contains("section"); next = next.nextElementSibling) any ||= !next.hidden;
    title.hidden = !any;
  }
  count.textContent = wanted.length ? `${seen} of ${rowsOf(table).length} rows` : "";
}

function listCells(table) {  // rows of texts, headings first, cells over several rows in each, without hidden rows
  const copy = table.cloneNode(true);
  spreadSpans(copy);
  const head = [...(table.tHead?.rows ?? [])];
  const names = [];
  if (head.length > 1) for (const cell of head[0].cells) for (let k = 0; k < cell.colSpan; k++) names.push(textOf(cell));
  const titles = [...(head.at(-1)?.cells ?? [])].map((cell, k) => `${names[k] ?? ""} ${textOf(cell)}`.trim());
  const rows = rowsOf(copy).filter((row) => !row.hidden);
  const cells = rows.map((row) => [...row.cells].map((cell) => textOf(cell).replace(/−(?=[\d∞])/g, "-").replace(/^–$/, "")));
  return titles.length ? [titles, ...cells] : cells;
}

const quote = (text) => {
  const safe = /^[=@\t]|^[+-](?![\d.∞])/.test(text) ? `'${text}` : text;  // no spreadsheet is to compute it
  return /[",\n]/.test(safe) ? `"${safe.replace(/"/g, '""')}"` : safe;
};

function saveTable(table, name) {
  const text = listCells(table).map((row) => row.map(quote).join(",")).join("\n") + "\n";
  const link = make("a", { download: `${name}.csv`, href: URL.createObjectURL(new Blob(["\ufeff", text], { type: "text/csv" })) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

async function copyTable(table, button) {
  const text = listCells(table).map((row) => row.join("\t")).join("\n");
  try { await navigator.clipboard.writeText(text); } catch {
    const area = make("textarea", { value: text });
    button.after(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = "Copy"; }, 1500);
}

all("div.table").forEach((box, number) => {
  const table = box.querySelector("table"), caption = box.querySelector(".caption");
  const title = caption ? textOf(caption) : `table ${number + 1}`;
  const slug = title.toLowerCase().replace(/[^a-z0-9]+/g, "_").replace(/^_|_$/g, "").slice(0, 40) || "table";
  const tools = make("div", { className: "tools" }), rows = rowsOf(table);
  const head = table.tHead?.rows ?? [];
  if (head.length && rows.length > 1) {
    [...head[head.length - 1].cells].forEach((cell, column) => {
      if (cell.tagName !== "TH") return;
      const button = make("button", { type: "button", title: "Sort" }, ...cell.childNodes);
      button.addEventListener("click", () => sortTable(table, cell, column));
      cell.append(button);
    });
    if (rows.length >= FEWEST) {
      const count = make("span", { className: "count", role: "status" });
      const field = make("input", { type: "search", placeholder: "Filter rows", ariaLabel: `Filter rows: ${title}` });
      field.addEventListener("input", () => filterTable(table, field.value, count));
      tools.append(field, count);
    }
  }
  const copy = make("button", { type: "button", ariaLabel: `Copy: ${title}` }, "Copy");
  const save = make("button", { type: "button", ariaLabel: `CSV: ${title}` }, "CSV");
  copy.addEventListener("click", () => copyTable(table, copy));
  save.addEventListener("click", () => saveTable(table, slug));
  tools.append(copy, save);
  box.querySelector(".scroll").before(tools);
});

// a box that scrolls can be reached by keyboard
const reach = () => all(".scroll, .picture").forEach((box) => {
  if (box.scrollWidth > box.clientWidth + 1) {
    box.tabIndex = 0;
    box.setAttribute("role", "group");
    const label = textOf(box.parentNode.querySelector(".caption, figcaption")) || "Table";
    box.setAttribute("aria-label", `${label.slice(0, 80)} (scrolls)`);
  } else if (box.tabIndex === 0) ["tabindex", "role", "aria-label"].forEach((name) => box.removeAttribute(name));
});
addEventListener("resize", reach);
addEventListener("toggle", reach, true);
reach();

// --- terms, explained where they stand for the first time in a section ---
const terms = new Map();
all("#glossary dt").forEach((term) => {
  for (const word of term.dataset.words.split("|")) terms.set(word.toLowerCase(), term.nextElementSibling.textContent);
});
const words = [...terms.keys()].sort((a, b) => b.length - a.length).map((word) => word.replace(/[.*+?^${}()|[\]\\]/g, "\\$&"));
const pattern = words.length && new RegExp(`(?<![\\p{L}\\d_-])(${words.join("|")})(?![\\p{L}\\d_])`, "iu");
const skipped = "abbr, button, summary, a, svg, pre, h1, h2, h3, dt, .kind, .tools, td.name, #glossary, #provenance";
for (const section of pattern ? all("main > section") : []) {
  const met = new Set(), walker = document.createTreeWalker(section, NodeFilter.SHOW_TEXT), nodes = [];
  while (walker.nextNode()) if (!walker.currentNode.parentElement.closest(skipped)) nodes.push(walker.currentNode);
  for (let node of nodes) {
    for (let found, from = 0; (found = pattern.exec(node.data.slice(from))); ) {
      const word = found[0].toLowerCase(), text = terms.get(word), at = from + found.index;
      if (met.has(text)) { from = at + word.length; continue; }
      met.add(text);
      const rest = node.splitText(at), after = rest.splitText(word.length);
      const mark = make("abbr", { title: text, tabIndex: 0 });
      rest.replaceWith(mark);
      mark.append(rest);
      node = after;
      from = 0;
    }
  }
}

// --- values and terms under the pointer, at once and by touch and keyboard too ---
const tip = make("div", { id: "tip", role: "tooltip", hidden: true });
document.body.append(tip);
const hide = () => { tip.hidden = true; };
function tell(target, x, y) {
  const mark = target.closest?.("abbr[title], abbr[data-tip], .tip, .tip use");
  if (!mark) return hide();
  const title = mark.querySelector(":scope > title");
  if (title) { mark.dataset.tip = title.textContent; title.remove(); }
  if (mark.title) { mark.dataset.tip = mark.title; mark.removeAttribute("title"); mark.setAttribute("aria-describedby", "tip"); }
  if (!mark.dataset.tip) return hide();
  tip.textContent = mark.dataset.tip;
  tip.hidden = false;
  const width = document.documentElement.clientWidth, size = tip.getBoundingClientRect();
  tip.style.left = `${Math.max(4, Math.min(x + 12, width - size.width - 4))}px`;
  tip.style.top = `${y + 18 + size.height > innerHeight ? y - size.height - 10 : y + 18}px`;
}
addEventListener("pointerover", (event) => tell(event.target, event.clientX, event.clientY));
addEventListener("pointerdown", (event) => tell(event.target, event.clientX, event.clientY));
addEventListener("focusin", (event) => {
  const box = event.target.getBoundingClientRect();
  tell(event.target, box.left, box.top);
});
addEventListener("focusout", hide);
addEventListener("scroll", hide, true);
addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });

// --- contents: where one is ---
const links = new Map(all("nav a").map((link) => [link.getAttribute("href").slice(1), link]));
let chosen = 0;  // when a link was followed last: the end of a page cannot be scrolled to its top
function mark(link) {
  links.forEach((one) => one.removeAttribute("aria-current"));
  link.setAttribute("aria-current", "true");
  const bar = link.closest("nav");
  bar.scrollLeft = link.offsetLeft - bar.clientWidth / 2;
}
links.forEach((link) => link.addEventListener("click", () => { chosen = performance.now(); mark(link); }));
const inSight = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    const link = links.get(entry.target.id);
    if (entry.isIntersecting && link && performance.now() > chosen + 800) mark(link);
  }
}, { rootMargin: "-10% 0px -80% 0px" });
all("main > section[id]").forEach((section) => inSight.observe(section));
addEventListener("hashchange", () => {  // what is linked to is unfolded
  for (let fold = document.getElementById(location.hash.slice(1))?.closest("details"); fold; fold = fold.parentNode.closest("details")) fold.open = true;
});
})();
