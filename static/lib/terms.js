// What each number means: one sentence, a formula where there is one, and where the guide explains it.

export const TERMS = {
  name: ["Name", "What the recording is called. Change it on the run's page."],
  robot: ["Robot", "The robot that drove. Click one at the left to see only its runs."],
  when: ["When", "When the run was stored here."],
  length: ["Length", "From the first to the last stamp over all streams.", "t₁ − t₀"],
  streams: ["Streams", "What was recorded. Grey and dashed: absent. Amber: the stamps pause for over ten typical steps somewhere."],
  best_error: ["Best error", "The smallest absolute trajectory error of any method on this run, against its truth.", "min over methods of ATE"],
  bias_drift: ["Bias drift", "How far the gyro's bias moved from the start to the end of the run, by the best estimate of it.", "b(t₁) − b(t₀)"],
  verdict: ["Verdict", "What is known of this run in a few words."],
  path: ["Path", "The best path known: truth where there is one, else the best method's. North up, not to a common scale."],
  tags: ["Tags", "Your words for runs. Search with tag:word."],
  ate_rmse_m: ["Absolute trajectory error", "Root mean square distance between the path and the truth at the truth's stamps. Nothing is aligned first: both start in the same map.", "√(mean ‖p(t) − p̂(t)‖²)"],
  final_m: ["Final error", "Distance from the truth at the last common stamp.", "‖p(t₁) − p̂(t₁)‖"],
  final_rad: ["Final heading error", "Heading difference to the truth at the last common stamp, wrapped.", "wrap(θ̂(t₁) − θ(t₁))"],
  max_m: ["Largest error", "The largest distance from the truth anywhere on the run.", "max ‖p(t) − p̂(t)‖"],
  max_rad: ["Largest heading error", "The largest heading difference to the truth anywhere on the run.", "max |wrap(θ̂ − θ)|"],
  heading_rmse_rad: ["Heading error", "Root mean square of the heading difference to the truth.", "√(mean wrap(θ̂ − θ)²)"],
  rpe_m: ["Relative error", "Error gathered over one metre of way, root mean square: how fast the path goes wrong, wherever it is by then."],
  nees: ["NEES", "Squared error in units of the claimed uncertainty, averaged. Near the number of states (3): honest. Larger: too sure of itself.", "mean eᵀ P⁻¹ e"],
  runtime_s: ["Run time", "Computing time of the estimate, after loading."],
  error_xy: ["Position error", "Distance between the path and the truth at each stamp.", "‖p(t) − p̂(t)‖"],
  error_theta: ["Heading error", "Heading difference to the truth at each stamp, wrapped.", "wrap(θ̂ − θ)"],
  heading_max_rad: ["Largest heading error", "The largest heading difference to the truth anywhere on the run.", "max |wrap(θ̂ − θ)|"],
  mean_m: ["Mean error", "Mean distance from the truth.", "mean ‖p(t) − p̂(t)‖"],
  rpe_per_m_m: ["Relative error per metre", "How wrong one metre of way is, root mean square over all of them: an early mistake is not counted again later.", "‖(T(sᵢ)⁻¹ T(sᵢ+1 m))⁻¹ (T̂(sᵢ)⁻¹ T̂(sᵢ+1 m))‖"],
  bias_drift_rad_s: ["Bias drift", "How far the gyro's bias moved from the start to the end of the run.", "b̂(t₁) − b̂(t₀)"],
  gyro_bias: ["Gyro bias", "The turn rate that the gyro reads at rest, as the method estimates it; bands are one and two sigma of its own claim.", "b̂(t) ± σ, 2σ"],
  distance_m: ["Length of the path", "Sum of all steps of the estimated path."],
  sampling: ["Sampling", "What is drawn is thinned by the server so that extremes stay; zoom in and it is drawn again from all samples."],
};

const GUIDE = "/guide/numbers";

/** {label, text, formula, guide} of a term, or null. */
export function term(name) {
  const found = TERMS[name];
  return found ? { label: found[0], text: found[1], formula: found[2], guide: `${GUIDE}#${name.replaceAll("_", "-")}` } : null;
}
