// Where a value stands on its slider. Positions run from -1000 to 1000 around neutral, or 0 to 1000.
//
// Most effects matter over decades: near neutral a step is a fraction of what is just material (`small`), at the ends
// it is the physical range. Places and times are linear over what the run covers; limits are logarithmic, with a switch.

const DEG = 180 / Math.PI;
const STEPS = 1000;
const PLACES = new Set(["x", "y", "radius"]);

/** Radians are told in degrees. */
export const humanOf = (unit) => (unit.startsWith("rad") ? { factor: DEG, unit: unit.replaceAll("rad", "°") } : { factor: 1, unit });

/** {min, max, toPosition, toValue, optional}; reach: {x, y, size, t0, t1} of the run. */
export function scaleOf(parameter, reach) {
  if (parameter.neutral === null) return { ...logarithmic(Math.max(parameter.low, 0.01), 10), optional: true };
  const [low, high] = [parameter.low ?? -1e3, parameter.high ?? 1e3];
  if (parameter.small === null) return plain(parameter, low, high, reach);
  return around(parameter.neutral, low, high, parameter.small);
}

function plain(parameter, low, high, reach) {
  if (parameter.name === "time") return linear(reach.t0, reach.t1);
  if (parameter.name === "radius") return linear(0, Math.max(reach.size, 1));
  if (PLACES.has(parameter.name)) return linear(reach[parameter.name] - reach.size, reach[parameter.name] + reach.size);
  return logarithmic(Math.max(low, 0.01), high);
}

function linear(low, high) {
  return { min: 0, max: STEPS, toValue: (p) => low + (p / STEPS) * (high - low), toPosition: (v) => ((v - low) / (high - low)) * STEPS };
}

function logarithmic(low, high) {
  const ratio = Math.log(high / low);
  return { min: 0, max: STEPS, toValue: (p) => low * Math.exp((p / STEPS) * ratio), toPosition: (v) => (Math.log(Math.max(v, low) / low) / ratio) * STEPS };
}

function around(neutral, low, high, small) {
  const decades = (span) => Math.log(1 + span / small);
  const [down, up] = [neutral - low, high - neutral];
  const toValue = (p) => {
    const span = p < 0 ? down : up;
    return neutral + Math.sign(p) * Math.min(small * Math.expm1((Math.abs(p) / STEPS) * decades(span)), span);
  };
  const toPosition = (v) => {
    const span = v < neutral ? down : up;
    return span > 0 ? Math.sign(v - neutral) * STEPS * (Math.log1p(Math.abs(v - neutral) / small) / decades(span)) : 0;
  };
  return { min: down > 0 ? -STEPS : 0, max: up > 0 ? STEPS : 0, toValue, toPosition };
}

/** Four significant digits of what differs from neutral, so that fields stay readable. */
export function tidy(value, neutral = 0) {
  const base = neutral ?? 0;
  return Number((base + Number((value - base).toPrecision(3))).toPrecision(8));
}
