// One colour, one dash per bias method. Kin of the methods of the path look like them: the published one, our best, ours with hindsight.

export const BIAS_METHODS = {
  A: { label: "A", color: "--method-encoders", dash: [7, 3], width: 1.5 },
  B: { label: "B", color: "--method-beacon", dash: [2, 3], width: 1.75 },
  C: { label: "C", color: "--method-published", dash: [9, 3, 2, 3], width: 1.5 },
  best: { label: "best", color: "--method-fused", dash: [], width: 2 },
  smoothed: { label: "smoothed", color: "--method-smoothed", dash: [12, 3], width: 1.75 },
};

export const TRUTH = { label: "truth", color: "--method-truth", dash: [], width: 1.5 };

export const biasStyle = (name) => BIAS_METHODS[name] ?? { label: name, color: "--ink-3", dash: [4, 4], width: 1.5 };

// What became of a segment: shape and colour, never colour alone.
export const VERDICTS = {
  accepted: { label: "accepted", help: "Segments whose mean entered the bias.", mark: "dot" },
  rejected_by_range: { label: "rejected by range", help: "Segments whose range is too large for rest: the robot moved. Off the scale they stand at its edge.", mark: "cross", color: "--ink-3" },
  rejected_by_average: { label: "rejected by average", help: "Segments that pass the range test, but whose mean is too far from the average before them: a slow turn.", mark: "triangle", color: "--red" },
};

const DEG = 180 / Math.PI;

/** How the readings of an axis are told: unit, factor from SI, and the same for a bias. */
export function axisUnits(axis) {
  return axis.startsWith("g")
    ? { si: "rad/s", unit: "°/s", factor: DEG, fine: "°/h", fineFactor: DEG * 3600, label: `turn rate about ${axis[1]}` }
    : { si: "m/s²", unit: "m/s²", factor: 1, fine: "m/s²", fineFactor: 1, label: `specific force along ${axis[1]}` };
}
