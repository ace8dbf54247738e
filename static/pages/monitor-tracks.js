// What is known of the path by one method, in memory that stays level: the older a stretch, the fewer poses are kept.

const COLUMNS = ["t", "x", "y", "theta", "sd_x", "sd_y", "sd_theta", "cov_xy"];
const MOST = 3000; // poses
const NEWEST = 600; // of them untouched

export function createTrack() {
  const rows = Object.fromEntries([...COLUMNS, "speed", "gap"].map((name) => [name, []]));
  const track = {
    rows,
    now: null, // the newest pose, drawn ahead of its path
    extend,
    clear() {
      for (const column of Object.values(rows)) column.length = 0;
      track.now = null;
    },
  };

  // path: columns of poses; gap: how far outside its noise floor the chain was then, null where unknown.
  function extend(path, gap) {
    for (let i = 0; i < path.t.length; i++) {
      const last = rows.t.length - 1;
      if (last >= 0 && path.t[i] <= rows.t[last]) continue;
      rows.speed.push(last < 0 ? 0 : speed(path, i, last));
      rows.gap.push(gap);
      for (const name of COLUMNS) rows[name].push(path[name]?.[i] ?? null);
    }
    if (rows.t.length > MOST) thin();
  }

  // Over a fifth of a second at least: of neighbours it would be noise.
  function speed(path, i, last) {
    let back = last;
    while (back > 0 && path.t[i] - rows.t[back] < 0.2) back--;
    return Math.hypot(path.x[i] - rows.x[back], path.y[i] - rows.y[back]) / (path.t[i] - rows.t[back]);
  }

  function thin() {
    const old = rows.t.length - NEWEST;
    for (const column of Object.values(rows)) {
      let kept = 0;
      for (let i = 0; i < column.length; i++) if (i >= old || i % 2 === 0) column[kept++] = column[i];
      column.length = kept;
    }
  }

  return track;
}
