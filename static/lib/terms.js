// What each number means: [label, one sentence, formula where there is one, where the guide explains it].

import { IMU_TERMS } from "./terms-imu.js";

export const TERMS = {
  ...IMU_TERMS,
  name: ["Name", "What the recording is called. Change it on the run's page."],
  robot: ["Robot", "The robot that drove. Click one at the left to see only its runs."],
  when: ["When", "When the run was stored here."],
  length: ["Length", "From the first to the last stamp over all streams.", "t₁ − t₀"],
  streams: ["Streams", "What was recorded. Grey and dashed: absent. Amber: the stamps pause for over ten typical steps somewhere.", null, "run-format"],
  best_error: ["Best error", "The smallest absolute trajectory error of any method on this run, against its truth.", "min over methods of ATE", "numbers#ate"],
  bias_drift: ["Bias drift", "How far the gyro's bias moved from the start to the end of the run, by the best estimate of it.", "b(t₁) − b(t₀)", "numbers#gyro-bias"],
  bias_drift_rad_s: ["Bias drift", "How far the gyro's bias moved from the start to the end of the run.", "b(t₁) − b(t₀)", "numbers#gyro-bias"],
  verdict: ["Verdict", "What the last sim-to-real diagnosis said of this run."],
  path: ["Path", "The best path known. The dot is its start. Each is scaled to fit."],
  tags: ["Tags", "Your words for runs. Search with tag:word."],
  ate_rmse_m: ["Absolute trajectory error", "Root mean square distance between the path and the truth. Nothing is aligned first: both are in the map.", "√(mean ‖p(t) − p̂(t)‖²)", "numbers#ate"],
  mean_m: ["Mean error", "Mean distance between the path and the truth.", "mean ‖p(t) − p̂(t)‖", "numbers#ate"],
  final_m: ["Final error", "Distance from the truth at the last common stamp.", "‖p(t₁) − p̂(t₁)‖", "numbers#final-and-maximum-error"],
  final_rad: ["Final heading error", "Heading difference to the truth at the last common stamp, wrapped.", "wrap(θ̂(t₁) − θ(t₁))", "numbers#final-and-maximum-error"],
  max_m: ["Largest error", "The largest distance from the truth anywhere on the run.", "max ‖p(t) − p̂(t)‖", "numbers#final-and-maximum-error"],
  heading_max_rad: ["Largest heading error", "The largest heading difference to the truth anywhere on the run.", "max |wrap(θ̂ − θ)|", "numbers#heading-error"],
  heading_rmse_rad: ["Heading error", "Root mean square of the heading difference to the truth.", "√(mean wrap(θ̂ − θ)²)", "numbers#heading-error"],
  rpe_per_m_m: ["Relative error per metre", "Position error gathered over one metre of way, root mean square: how fast the path goes wrong, wherever it is by then.", null, "numbers#rpe"],
  rpe_per_m_rad: ["Relative turn per metre", "Heading error gathered over one metre of way, root mean square.", null, "numbers#rpe"],
  rpe_per_s_m: ["Relative error per second", "Position error gathered over one second, root mean square.", null, "numbers#rpe"],
  rpe_per_s_rad: ["Relative turn per second", "Heading error gathered over one second, root mean square.", null, "numbers#rpe"],
  matched: ["Matched stamps", "Stamps of the truth that the path covers; the errors are taken there."],
  unmatched: ["Unmatched stamps", "Stamps of the truth that the path does not cover. They are counted, not dropped in silence."],
  nees: ["NEES", "Squared error in units of the claimed uncertainty, averaged. Near its degrees of freedom: honest. Larger: too sure of itself.", "mean eᵀ P⁻¹ e", "numbers#nees"],
  nees_dof: ["NEES, degrees of freedom", "How many components of the pose the NEES is over: the value an honest filter has.", null, "numbers#nees"],
  nees_inside: ["NEES inside its band", "Share of stamps at which the error is within the band of 95 % that was claimed.", null, "numbers#nees"],
  distance_m: ["Way driven", "Length of the path."],
  runtime_s: ["Run time", "Computing time of the estimate, after loading."],
  error_xy: ["Position error", "Distance between the path and the truth at each stamp.", "‖p(t) − p̂(t)‖", "numbers#ate"],
  error_theta: ["Heading error", "Heading difference to the truth at each stamp, wrapped.", "wrap(θ̂ − θ)", "numbers#heading-error"],
  sampling: ["Sampling", "What is drawn is thinned by the server so that extremes stay; zoom in and it is drawn again from all samples."],
};

const SENSOR = { label: (name) => `NIS, ${name.slice(4).replaceAll("_", " ").replace(".", " ")}`, text: "Squared innovation of this sensor in units of its predicted uncertainty, averaged. Near its degrees of freedom: honest.", formula: "mean νᵀ S⁻¹ ν", guide: "/guide/numbers#nis" };

/** {label, text, formula, guide} of a term, or null. */
export function term(name) {
  if (name?.startsWith("nis_")) return { ...SENSOR, label: SENSOR.label(name) };
  const found = TERMS[name];
  return found ? { label: found[0], text: found[1], formula: found[2], guide: found[3] && `/guide/${found[3]}` } : null;
}
