// The axes of a sensor's triad, and how its readings are told.

const DEG = 180 / Math.PI;

export const TRIAD = {
  x: { color: "--method-encoders", dash: [7, 3], mark: "cross" },
  y: { color: "--method-fused", dash: [], mark: "dot" },
  z: { color: "--method-smoothed", dash: [12, 3], mark: "triangle" },
};

export const SENSORS = {
  gyro: { label: "Gyro", letter: "g", si: "rad/s", unit: "°/s", factor: DEG, fine: "°/h", fineFactor: DEG * 3600 },
  accel: { label: "Accelerometer", letter: "a", si: "m/s²", unit: "m/s²", factor: 1, fine: "mm/s²", fineFactor: 1000 },
};

export const sensorOf = (axis) => SENSORS[axis.startsWith("g") ? "gyro" : "accel"];
export const styleOf = (axis) => TRIAD[axis[1]];
