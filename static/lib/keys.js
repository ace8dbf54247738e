// Keyboard: pages register keys with what they do; `?` shows the list in a panel beside the page.

import { $, h, icon } from "./dom.js";

const groups = new Map();
const handlers = new Map();

/** keys("Table", {j: ["next run", f], ...}): a key is what KeyboardEvent.key says. A later page-level key wins. */
export function keys(group, table) {
  const rows = groups.get(group) ?? [];
  for (const [key, [label, handler, shown]] of Object.entries(table)) {
    handlers.set(key, handler);
    if (label) rows.push([shown ?? key, label]);
  }
  groups.set(group, rows);
}

const typing = (target) => target.closest?.("input:not([type=checkbox], [type=radio], [type=range]), textarea, select, [contenteditable]");

function press(event) {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
  if (typing(event.target)) {
    if (event.key === "Escape") event.target.blur();
    return;
  }
  if ((event.key === "Enter" || event.key === " ") && event.target.closest?.("a, button, summary, label, input")) return;
  const handler = handlers.get(event.key);
  if (handler && handler(event) !== false) event.preventDefault();
}

const NAMES = { " ": "space", ArrowDown: "↓", ArrowUp: "↑", ArrowLeft: "←", ArrowRight: "→", Escape: "Esc" };

function helpPanel() {
  const sections = [...groups].map(([name, rows]) => [
    h("h3", {}, name),
    h("dl", {}, rows.map(([key, label]) => [h("dt", {}, key.split(" ").map((k) => h("kbd", {}, NAMES[k] ?? k))), h("dd", {}, label)])),
  ]);
  const shut = h("button", { class: "icon-button", type: "button", "aria-label": "Close", onclick: () => toggleHelp(false) }, icon("close"));
  return [h("header", {}, h("h2", {}, "Keys"), shut), sections];
}

export function toggleHelp(open = $("#help-panel").hidden) {
  const panel = $("#help-panel");
  panel.replaceChildren(...(open ? helpPanel().flat(3) : []));
  panel.hidden = !open;
  $("#help")?.setAttribute("aria-expanded", String(open));
}

export function startKeys() {
  document.addEventListener("keydown", press);
  $("#help")?.addEventListener("click", () => toggleHelp());
  keys("Everywhere", {
    "/": ["search", () => $("#search")?.focus()],
    "?": ["this list", () => toggleHelp()],
    Escape: ["close the panel", () => toggleHelp(false)],
  });
}
