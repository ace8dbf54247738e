// Pointer, wheel and touch on one element, told as intentions. Plots and the map share it.
//
// handlers: hover(x, y) · leave() · click(x, y, event) · reset() · pan(dx, dy) · zoom(factor, x, y)
//           select(x0, x1, done)   only where a plain drag selects; shift-drag and touch then pan
// Coordinates are CSS pixels inside the element. Returns a function that takes everything off again.

const CLICK_SLOP = 4; // px a pointer may move and still click

// A wheel that scrolls the page keeps scrolling it when a plot slides under a resting pointer: only a pointer that
// has moved since the page last scrolled zooms.
let pageScrolled = false;
let lastMove = [0, 0];
addEventListener("scroll", () => (pageScrolled = true), { passive: true, capture: true });
addEventListener(
  "pointermove",
  (event) => {
    if (event.screenX !== lastMove[0] || event.screenY !== lastMove[1]) pageScrolled = false;
    lastMove = [event.screenX, event.screenY];
  },
  { passive: true, capture: true },
);

export function gestures(element, handlers) {
  const pointers = new Map();
  const abort = new AbortController();
  const on = (name, handler, options = {}) =>
    element.addEventListener(name, handler, { ...options, signal: abort.signal });
  let start = null; // {x, y, mode: "select" | "pan"} of the drag under way
  let pinch = null; // {distance, x, y} of the last two-finger position
  let moved = false;

  const at = (event) => {
    const box = element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  on("pointerdown", (event) => {
    if (event.button !== 0) return;
    const [x, y] = at(event);
    pointers.set(event.pointerId, [x, y]);
    element.setPointerCapture(event.pointerId);
    if (pointers.size === 2) {
      pinch = span(pointers);
      start = null;
      moved = true;
      return;
    }
    const selects = handlers.select && event.pointerType === "mouse" && !event.shiftKey;
    start = { x, y, lastX: x, lastY: y, mode: selects ? "select" : "pan" };
    moved = false;
  });

  on("pointermove", (event) => {
    const [x, y] = at(event);
    if (!pointers.has(event.pointerId)) {
      handlers.hover?.(x, y);
      return;
    }
    pointers.set(event.pointerId, [x, y]);
    if (pinch) {
      const next = span(pointers);
      if (next.distance > 0) handlers.zoom?.(pinch.distance / next.distance, next.x, next.y);
      handlers.pan?.(next.x - pinch.x, next.y - pinch.y);
      pinch = next;
      return;
    }
    if (!start) return;
    if (!moved && Math.hypot(x - start.x, y - start.y) < CLICK_SLOP) return;
    moved = true;
    if (start.mode === "select") handlers.select(start.x, x, false);
    else handlers.pan?.(x - start.lastX, y - start.lastY);
    start.lastX = x;
    start.lastY = y;
  });

  const release = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    const [x, y] = at(event);
    if (pinch && pointers.size < 2) pinch = null;
    else if (start && !moved && event.type === "pointerup") handlers.click?.(x, y, event);
    else if (start?.mode === "select" && moved) handlers.select(start.x, x, event.type === "pointerup" ? true : null);
    start = null;
  };
  on("pointerup", release);
  on("pointercancel", release);
  on("pointerleave", () => {
    if (!pointers.size) handlers.leave?.();
  });
  on("dblclick", (event) => {
    event.preventDefault();
    handlers.reset?.();
  });

  on(
    "wheel",
    (event) => {
      if (pageScrolled && !event.ctrlKey) return;
      event.preventDefault();
      const unit = event.deltaMode === 1 ? 16 : 1;
      const [x, y] = at(event);
      if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
        handlers.pan?.(-(event.deltaX || event.deltaY) * unit, 0);
      } else {
        handlers.zoom?.(Math.exp(clamp(event.deltaY * unit, -240, 240) * 0.0022), x, y);
      }
    },
    { passive: false },
  );

  return () => abort.abort();
}

function span(pointers) {
  const [[ax, ay], [bx, by]] = [...pointers.values()];
  return { distance: Math.hypot(ax - bx, ay - by), x: (ax + bx) / 2, y: (ay + by) / 2 };
}

function clamp(value, lo, hi) {
  return Math.min(Math.max(value, lo), hi);
}
