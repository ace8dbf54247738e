// Facets: one search string is the truth; a facet is a term of it, added or taken away by a click.

import { h } from "../lib/dom.js";
import { count } from "../lib/format.js";

const GROUPS = [
  ["robot", "Robot", "robots"],
  ["tag", "Tag", "tags"],
  ["has", "Streams", "streams"],
  ["gap", "Gap verdict", "verdicts"],
];
const WORDS = { none: "no gap", partly_explained: "partly explained", unknown: "unknown cause" };
const SHOWN = 8;
const expanded = new Set();

const quoted = (value) => (/\s|"/.test(value) ? `"${value.replaceAll('"', "")}"` : value);
const TERM = /(?:(robot|tag|has|gap):)?(?:"([^"]*)"|(\S+))/gi;

/** The terms of a search string: [{key, value, text}]. */
export function terms(q) {
  return [...q.matchAll(TERM)].map((m) => ({ key: m[1]?.toLowerCase() ?? null, value: m[2] ?? m[3], text: m[0] }));
}

const same = (t, key, value) => t.key === key && t.value.toLowerCase() === value.toLowerCase();

export const has = (q, key, value) => terms(q).some((t) => same(t, key, value));

/** The search string with `key:value` added, or without it where it was there. */
export function toggle(q, key, value) {
  const rest = terms(q).filter((t) => !same(t, key, value));
  const parts = rest.map((t) => t.text);
  if (rest.length === terms(q).length) parts.push(`${key}:${quoted(value)}`);
  return parts.join(" ");
}

export function paintFacets(root, facets, q, onChange) {
  root.replaceChildren(
    ...GROUPS.map(([key, label, name]) => {
      const values = Object.entries(facets[name] ?? {});
      const chosen = terms(q).filter((t) => t.key === key && !values.some(([v]) => same(t, key, v)));
      const rows = [...chosen.map((t) => [t.value, 0]), ...values];
      if (rows.length === 0) return null;
      const all = expanded.has(key);
      const more = rows.length > SHOWN && h("li", {}, h("button", { class: "facet-more", type: "button", onclick: () => { expanded[all ? "delete" : "add"](key); paintFacets(root, facets, q, onChange); } }, all ? "fewer" : `${rows.length - SHOWN} more`));
      return h(
        "section",
        { class: "facet", "data-facet": key },
        h("h3", {}, label),
        h("ul", {}, (all ? rows : rows.slice(0, SHOWN)).map(([value, n]) => {
          const on = has(q, key, value);
          return h("li", {}, h("button", { type: "button", "aria-pressed": String(on), onclick: () => onChange(toggle(q, key, value)) }, h("span", { class: "clip" }, (key === "gap" && WORDS[value]) || value), h("span", { class: "num" }, count(n))));
        }), more),
      );
    }).filter(Boolean),
  );
}
