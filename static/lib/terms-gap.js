// What each number of a diagnosis means: as TERMS of terms.js.

export const GAP_TERMS = {
  gap_fitted: ["Fitted", "The effects are found from this run."],
  gap_held_out: ["Held out", "This run took no part in the fit: it only judges how far the gap shrinks. Without one, stretches of the same runs judge, which flatters a little.", null, "diagnoses#how-far"],
  gap_tolerance: ["What matters", "Sizes below which an effect is real but immaterial: listed apart, never told as a cause. Without yours, the table's tolerances hold.", null, "diagnoses#what-matters"],
  gap_heat: ["Where the gap lies", "Each stream while the robot does something: its gap over the noise floor, before anything is added. A dot: significant, under one false-discovery control over all cells.", "rms of residuals / floor", "diagnoses#where"],
  gap_spot_share: ["Share of the gap", "Of all energy above the noise floor, the part that lies here."],
  gap_p: ["p", "How often noise alone would leave so much here.", null, "diagnoses#where"],
  gap_timeline: ["Gap over time", "Root mean square of residuals in units of the noise, over all streams, in blocks of time; single streams from the legend."],
  gap_probability: ["Probability", "That this effect is at work, against every other effect, none, and something in no list. Honest where among ten told at 0.9 nine are right.", null, "diagnoses#which"],
  gap_part: ["Part of the gap", "Of the gap above the noise floor, the part that adding this effect takes away. Where causes act in the same streams the parts are told in proportion and add up to what is explained.", null, "diagnoses#which"],
  gap_share: ["Comes back without it", "The part of what is explained that leaving this effect out would bring back.", null, "diagnoses#which"],
  gap_interval: ["Interval", "Holds the true value in 90 of 100 cases.", "value ± 1.645 sd", "diagnoses#which"],
  gap_sets: ["Cannot be told apart", "These runs look the same under either effect. The next drive would part them.", null, "diagnoses#next"],
  gap_signature: ["Signature", "The residual of the stream that shows the effect most, by what it depends on: dots with two deviations without the effect, line with it, dashed what is left.", null, "diagnoses#which"],
  gap_unseen: ["Cannot see", "Parameters that these runs would not have shown at the size that matters, and the size from which on they would.", null, "diagnoses#which"],
  gap_far: ["Gap", "Root mean square of residuals through the whole chain, in units of the stated noise: with the simulator as it is, with the effects added, and what noise alone leaves.", "√(mean r²/σ²)", "diagnoses#how-far"],
  gap_floor: ["Noise floor", "What noise alone leaves, estimated from the data's own fast changes, beside what run.json states.", null, "diagnoses#how-far"],
  gap_overlay: ["Effects added", "The simulator drives the run's commands from the start in one go, with none to all of each effect. Small errors add up here: it shows what you would see, the figures above judge."],
  gap_immaterial: ["Immaterial", "Significant, but smaller than what matters. Long runs make every trifle significant.", null, "diagnoses#what-matters"],
};
