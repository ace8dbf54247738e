// Colours from CSS custom properties for everything drawn on canvas, and a word when the theme changes.

// "--name" or any CSS colour -> a colour that canvas understands.
export function colour(name, host = document.documentElement) {
  if (!name.startsWith("--")) return name;
  return getComputedStyle(host).getPropertyValue(name).trim() || "#888";
}

export function withAlpha(value, alpha) {
  const hex = value.match(/^#([0-9a-f]{6})$/i);
  if (!hex) return value;
  const n = parseInt(hex[1], 16);
  return `rgba(${n >> 16}, ${(n >> 8) & 255}, ${n & 255}, ${alpha})`;
}

// The frame says "themechange" whenever the colours change. Returns what stops it.
export function onThemeChange(callback) {
  document.addEventListener("themechange", callback);
  return () => document.removeEventListener("themechange", callback);
}
