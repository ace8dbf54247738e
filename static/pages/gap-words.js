// Sentences of a diagnosis: code stands in backticks.

import { h } from "../lib/dom.js";

export const said = (text) => text.split("`").map((part, i) => (i % 2 ? h("code", {}, part) : part));
