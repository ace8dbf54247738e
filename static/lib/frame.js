// What every page does: hints, keys, theme, jobs in progress.

import { $, icon } from "./dom.js";
import { startHints } from "./hint.js";
import { startJobsPill } from "./jobs.js";
import { startKeys } from "./keys.js";

const THEMES = ["auto", "light", "dark"];
const NAMES = { auto: "as the system", light: "light", dark: "dark" };
const root = document.documentElement;

/** Whether the page is dark now. */
export function isDark() {
  const theme = root.dataset.theme;
  return theme === "dark" || (theme === "auto" && matchMedia("(prefers-color-scheme: dark)").matches);
}

/** Calls back whenever the colours change; canvases must be drawn again. */
export function onTheme(callback) {
  document.addEventListener("themechange", () => callback(isDark()));
}

const announce = () => document.dispatchEvent(new CustomEvent("themechange"));

function startTheme() {
  const button = $("#theme");
  if (!button) return;
  const paint = () => {
    button.replaceChildren(icon(`theme-${root.dataset.theme}`));
    button.dataset.hint = `Colours: ${NAMES[root.dataset.theme]}. Click to change.`;
  };
  button.addEventListener("click", () => {
    root.dataset.theme = THEMES[(THEMES.indexOf(root.dataset.theme) + 1) % THEMES.length];
    document.cookie = `theme=${root.dataset.theme}; path=/; max-age=31536000; samesite=strict`;
    paint();
    announce();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", announce);
  paint();
}

// keys.js registers pages' own keys as they load; the frame is loaded first and may be loaded again by import.
startHints();
startKeys();
startTheme();
startJobsPill();
