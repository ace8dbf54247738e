// What each number means: [label, one sentence, formula where there is one, where the guide explains it].

import { GAP_TERMS } from "./terms-gap.js";
import { IMU_TERMS } from "./terms-imu.js";
import { LIVE_TERMS } from "./terms-live.js";

export const TERMS = {
  ...IMU_TERMS,
  ...GAP_TERMS,
  ...LIVE_TERMS,
  name: ["Name", "What the recording is called. Change it on the run's page."],
  robot: ["Robot", "The robot that drove. Click one at the left to see only its runs."],
  when: ["When", "When the run was stored here."],
  length: ["Length", "From the first to the last stamp over all streams.", "t₁ − t₀"],
  streams: ["Streams", "What was recorded. Grey and dashed: absent. Amber: the stamps pause for over ten typical steps somewhere.", null, "run-format"],
  best_error: ["Best error", "The smallest absolute trajectory error of any method on this run, against its truth.", "min over methods of ATE", "numbers#ate"],
  bias_drift: ["Bias drift", "How far the gyro's bias moved from the start to the end of the run, by the best estimate of it.", "b(t₁) − b(t₀)", "numbers#gyro-bias"],
  bias_drift_rad_s: ["Bias drift", "How far the gyro's bias moved from the start to the end of the run.", "b(t₁) − b(t₀)", "numbers#gyro-bias"],
  verdict: ["Gap verdict", "What the newest sim-to-real diagnosis that this run took part in said.", null, "diagnoses#the-verdict"],
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
  nis_running: ["Running mean NIS", "Squared surprise of each reading in units of what the filter expects, averaged over consecutive windows of accepted readings. Right: 95 % of the means lie in the band. Above: the sensor is noisier than told, below: better. Crosses: readings refused.", "mean νᵀ S⁻¹ ν", "numbers#nis"],
  nis_readings: ["Readings", "Readings of this sensor that the filter predicted."],
  nis_refused: ["Refused", "Share of readings outside their gate: not used, but counted here.", null, "numbers#nis"],
  nis_mean: ["Mean NIS", "Over accepted readings. Right: near the degrees of freedom, inside the band beside it.", "mean νᵀ S⁻¹ ν", "numbers#nis"],
  nis_band: ["Band of the mean", "Holds the mean of an honest filter in 95 of 100 runs; it counts as many readings as these are worth.", "χ²(n·dof) / n", "numbers#nis"],
  nis_effective: ["Independent", "How many independent readings these are worth: fewer where neighbours hang together.", "n / (1 + 2 Σ rₖ)", "numbers#whiteness"],
  whiteness: ["Whiteness", "Bars: autocorrelation of NIS (by ranks, so outliers do not count). White: 95 % of the bars within ± 2/√n. p: probability of such bars, were it white (Ljung-Box).", "Q = n(n+2) Σ rₖ² / (n−k)", "numbers#whiteness"],
  advice: ["R should be about", "The noise to tell the filter, over what it is told, with its 95 % interval: the median of NIS over that of chi-square, so that outliers do not count.", "median NIS / median χ²", "numbers#noise-advice"],
  events: ["Events", "What befell the robot, as this method found it. Click one to go there; confirm or dismiss it, and again to take that back.", null, "numbers#events"],
  sandbox_gap: ["Gap", "Root mean square of all residuals in units of the stated noise, the pose set anew every 2 s from the reference: the diagnosis's number. The mark is what noise alone leaves.", "√(mean over columns of rms²)", "effects#what-a-gap-is-and-its-shrinkage"],
  sandbox_lines: ["Paths", "Real: the reference, or the best estimated path. Nominal: the simulator as it is. Patched: with these effects. Both are driven from the start in one go; in 3D too."],
  sandbox_residual: ["Residual", "What was read minus what the simulator says at the same stamp, driven from the start in one go; headings wrapped. A scenario has no readings: patched minus nominal.", "real − simulated"],
  sandbox_seed: ["Seed", "Of all simulated noise. The same seed gives the same noise, so that only the effects differ."],
  sandbox_simulator: ["Simulator", "Our own, or one that whoever runs the server has registered; effects that it lacks are put around it where that is exact.", null, "own-simulator"],
  sampling: ["Sampling", "What is drawn is thinned by the server so that extremes stay; zoom in and it is drawn again from all samples."],
};

const SENSOR = { label: (name) => `NIS, ${name.slice(4).replaceAll("_", " ").replace(".", " ")}`, text: "Squared innovation of this sensor in units of its predicted uncertainty, averaged over accepted readings and degrees of freedom. Near 1: honest.", formula: "mean νᵀ S⁻¹ ν / dof", guide: "/guide/numbers#nis" };

/** {label, text, formula, guide} of a term, or null. */
export function term(name) {
  if (name?.startsWith("nis_") && !TERMS[name]) return { ...SENSOR, label: SENSOR.label(name) };
  const found = TERMS[name];
  return found ? { label: found[0], text: found[1], formula: found[2], guide: found[3] && `/guide/${found[3]}` } : null;
}
