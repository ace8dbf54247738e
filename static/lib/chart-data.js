// What a chart knows of its readings: the whole run coarsely, the visible range finely, and the two as one.

// Reading: { t: [], y: [], total, shown }; null in y where the source has no value.

export function merge(coarse, fine, range) {
  if (!coarse || coarse === fine) return fine;
  const before = lowerBound(coarse.t, range[0]);
  const after = lowerBound(coarse.t, range[1]);
  return {
    t: [...coarse.t.slice(0, before), ...fine.t, ...coarse.t.slice(after)],
    y: [...coarse.y.slice(0, before), ...fine.y, ...coarse.y.slice(after)],
  };
}

// A null in the middle of each gap breaks the line there.
export function breakAtGaps({ t, y }, gaps) {
  if (!gaps?.length || !t.length) return { t, y };
  const times = [];
  const values = [];
  let g = 0;
  for (let i = 0; i < t.length; i++) {
    while (g < gaps.length && t[i] >= gaps[g][1]) {
      const middle = (gaps[g][0] + gaps[g][1]) / 2;
      if (i > 0 && t[i - 1] < middle && middle < t[i]) {
        times.push(middle);
        values.push(null);
      }
      g += 1;
    }
    times.push(t[i]);
    values.push(y[i]);
  }
  return { t: times, y: values };
}

// Index of the first t >= value.
export function lowerBound(t, value) {
  let lo = 0;
  let hi = t.length;
  while (lo < hi) {
    const mid = (lo + hi) >> 1;
    if (t[mid] < value) lo = mid + 1;
    else hi = mid;
  }
  return lo;
}

// Value of the reading nearest to time, null more than a step outside the readings.
export function valueAt({ t, y }, time) {
  if (!t.length) return null;
  const step = t.length > 1 ? (t[t.length - 1] - t[0]) / (t.length - 1) : 0;
  if (time < t[0] - step || time > t[t.length - 1] + step) return null;
  const i = lowerBound(t, time);
  const j = i > 0 && (i === t.length || time - t[i - 1] < t[i] - time) ? i - 1 : i;
  return y[j] ?? null;
}

// [min, max] of y over the range, or null where nothing is there. One reading beyond each edge counts: lines cross it.
export function extent({ t, y }, [lo, hi]) {
  let min = Infinity;
  let max = -Infinity;
  const last = Math.min(lowerBound(t, hi) + 1, t.length);
  for (let i = Math.max(lowerBound(t, lo) - 1, 0); i < last; i++) {
    const v = y[i];
    if (v === null || v === undefined) continue;
    if (v < min) min = v;
    if (v > max) max = v;
  }
  return min <= max ? [min, max] : null;
}

// The middle 96 % of the values in the range, half as wide again: where a curve lives once it has settled.
export function settledExtent(readings, [lo, hi]) {
  const values = readings.flatMap(({ t, y }) => y.slice(lowerBound(t, lo), lowerBound(t, hi)).filter((v) => v !== null && v !== undefined));
  if (values.length < 20) return null;
  values.sort((a, b) => a - b);
  const [a, b] = [0.02, 0.98].map((share) => values[Math.round(share * (values.length - 1))]);
  const room = 0.25 * (b - a) || Math.abs(b) * 0.1;
  return [a - room, b + room];
}

// Two sigma of a band, but beyond the lines only by a share of their extent, lest they turn flat.
export function bandExtent({ t, mid, sd }, range, lines, share) {
  const lo = extent({ t, y: mid.map((m, i) => (m === null || sd[i] === null ? null : m - 2 * sd[i])) }, range);
  const hi = extent({ t, y: mid.map((m, i) => (m === null || sd[i] === null ? null : m + 2 * sd[i])) }, range);
  if (!lo || !hi) return null;
  if (!lines) return [lo[0], hi[1]];
  const room = share * Math.max(lines[1] - lines[0], 1e-12);
  return [Math.max(lo[0], lines[0] - room), Math.min(hi[1], lines[1] + room)];
}

// Rows of the visible range over all series: the union of their times, "" where a series has no reading there.
export function rows(readings, [lo, hi]) {
  const table = new Map();
  readings.forEach(({ t, y }, column) => {
    for (let i = lowerBound(t, lo); i < t.length && t[i] <= hi; i++) {
      if (!table.has(t[i])) table.set(t[i], new Array(readings.length).fill(""));
      table.get(t[i])[column] = y[i] ?? "";
    }
  });
  return [...table.entries()].sort((a, b) => a[0] - b[0]).map(([t, values]) => [t, ...values]);
}
