// A gap over its floor as a colour: the same steps as app/figures/gap.py.

export const LEVELS = [1.1, 1.5, 2.5, 4, 8, 16];

export const level = (gap) => (gap === null ? 0 : LEVELS.filter((edge) => gap >= edge).length);

export const levelColour = (k) => `--path-${k}`;
