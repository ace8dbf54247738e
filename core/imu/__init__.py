"""The IMU room: noise, gyro bias, calibration and correction. From a still log to filter settings."""
