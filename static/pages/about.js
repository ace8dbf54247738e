import { $ } from "../lib/dom.js";
import { bytes, count, show } from "../lib/format.js";

const size = $("[data-bytes]");
size.replaceChildren(show(bytes(Number(size.dataset.bytes))));
const files = $("[data-count]");
files.textContent = count(Number(files.dataset.count));
