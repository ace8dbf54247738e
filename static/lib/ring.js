// The newest rows of a stream in memory that never grows: columns of one length, oldest first, as typed arrays.
//
//   const ring = createRing(["gz", "ax"], 4000);
//   ring.push(t, { gz: [...], ax: [...] }); ring.since(t0) -> { t, gz, ax }   views, good until the next push

export function createRing(columns, capacity) {
  const room = 2 * capacity; // rows are moved to the front once per `capacity` pushes, not with every one
  const t = new Float64Array(room);
  const store = Object.fromEntries(columns.map((name) => [name, new Float64Array(room)]));
  let end = 0;

  function makeRoom(rows) {
    if (end + rows <= room) return;
    const keep = Math.min(end, capacity);
    for (const column of [t, ...Object.values(store)]) column.copyWithin(0, end - keep, end);
    end = keep;
  }

  return {
    get length() {
      return end;
    },
    get last() {
      return end ? t[end - 1] : null;
    },
    // Rows at or before the newest one are left out: what comes again or late is on the server, not here.
    push(stamps, values) {
      const after = end ? t[end - 1] : -Infinity;
      let from = Math.max(0, stamps.length - capacity);
      while (from < stamps.length && !(stamps[from] > after)) from++;
      makeRoom(stamps.length - from);
      for (let i = from; i < stamps.length; i++, end++) {
        t[end] = stamps[i];
        for (const name of columns) store[name][end] = values[name]?.[i] ?? NaN;
      }
    },
    since(t0) {
      let lo = 0;
      let hi = end;
      while (lo < hi) {
        const mid = (lo + hi) >> 1;
        if (t[mid] < t0) lo = mid + 1;
        else hi = mid;
      }
      const from = Math.max(0, lo - 1); // one row outside, so that the line comes in from the edge
      return { t: t.subarray(from, end), ...Object.fromEntries(columns.map((name) => [name, store[name].subarray(from, end)])) };
    },
    latest: (name) => (end ? store[name][end - 1] : NaN),
    clear() {
      end = 0;
    },
  };
}
