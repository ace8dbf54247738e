// Explanations on hover and on keyboard focus: [data-term] (see terms.js), [data-hint] (own words), [data-si].

import { h } from "./dom.js";
import { term } from "./terms.js";

const SELECTOR = "[data-term], [data-hint]";
const DELAY = 350;
let box = null;
let owner = null;
let timer = 0;

function content(element) {
  const known = term(element.dataset.term);
  const words = element.dataset.hint;
  return [
    known && h("b", {}, known.label),
    known && h("span", {}, known.text),
    known?.formula && h("div", { class: "formula" }, known.formula),
    words && h("div", {}, words),
    element.dataset.si && h("div", { class: "si" }, element.dataset.si),
    known?.guide && h("a", { href: known.guide }, "In the guide"),
  ].filter(Boolean);
}

function place(element) {
  const at = element.getBoundingClientRect();
  const size = box.getBoundingClientRect();
  const left = Math.max(8, Math.min(at.left, innerWidth - size.width - 8));
  const below = at.bottom + 6;
  const top = below + size.height > innerHeight - 8 ? at.top - size.height - 6 : below;
  box.style.left = `${left}px`;
  box.style.top = `${Math.max(8, top)}px`;
}

function open(element) {
  close();
  const parts = content(element);
  if (parts.length === 0) return;
  owner = element;
  box = h("div", { class: "hint", role: "tooltip", id: "hint" }, parts);
  document.body.append(box);
  element.setAttribute("aria-describedby", "hint");
  place(element);
}

function close() {
  clearTimeout(timer);
  owner?.removeAttribute("aria-describedby");
  box?.remove();
  box = owner = null;
}

function enter(event) {
  if (box?.contains(event.target)) return clearTimeout(timer);
  const element = event.target.closest?.(SELECTOR);
  if (element && element === owner) return clearTimeout(timer);
  clearTimeout(timer);
  timer = setTimeout(() => (element ? open(element) : close()), box && !element ? 200 : DELAY);
}

export function startHints() {
  document.addEventListener("pointerover", enter);
  document.addEventListener("focusin", (e) => {
    if (box?.contains(e.target)) return; // its link is being pressed
    if (e.target.matches?.(SELECTOR) && e.target.matches(":focus-visible")) open(e.target); // by key: a click has read it already
    else close();
  });
  document.addEventListener("pointerdown", (e) => box?.contains(e.target) || close());
  document.addEventListener("click", (e) => box?.contains(e.target) || close()); // what it did may lie below
  document.addEventListener("keydown", (e) => e.key === "Escape" && close());
  document.addEventListener("scroll", close, { capture: true, passive: true });
}
