// Notes: what people know of the run and the readings do not say. Saved as they are written.

import { api, problemNote } from "../lib/api.js";
import { debounce, h } from "../lib/dom.js";

export function mountNotes(host, { run }) {
  const area = h("textarea", { class: "notes-area", "aria-label": "Notes", placeholder: "What happened, what was odd, what to look at. Searched with the rest of the run.", maxlength: "100000" });
  area.value = run.notes;
  const status = h("p", { class: "dim", role: "status" }, run.notes ? "Saved." : "Saved as you write.");
  const box = h("div", { class: "notes stack" }, area, status);
  host.append(box);

  async function write() {
    const notes = area.value;
    if (notes === run.notes) return;
    try {
      await api(`runs/${run.id}`, { method: "PATCH", json: { notes } });
      run.notes = notes;
      status.replaceChildren(area.value === notes ? "Saved." : "Writing …");
    } catch (error) {
      status.replaceChildren(problemNote(error));
    }
  }

  const later = debounce(600, write);
  area.addEventListener("input", () => {
    status.textContent = "Writing …";
    later();
  });
  area.addEventListener("blur", write);
  return { setEvents() {}, destroy: () => (write(), box.remove()) };
}
