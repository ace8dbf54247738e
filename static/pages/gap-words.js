// Sentences of a diagnosis: code stands in backticks.

import { h } from "../lib/dom.js";

const STREAMS = { "wheels.left": "left encoder", "wheels.right": "right encoder", "imu.gz": "gyro", "imu.ax": "forward acceleration", "imu.ay": "sideways acceleration", "beacon.x": "fixes along x", "beacon.y": "fixes along y", "beacon.theta": "fixes' heading", "ranges.range": "ranges", "truth.x": "reference x", "truth.y": "reference y", "truth.theta": "reference heading" };

/** `imu.gz` as `gyro`: the same words as app/figures/gap_sentence.py. */
export const streamName = (stream) => STREAMS[stream] ?? stream;

export const said = (text) => text.replaceAll(" %", " %").split("`").map((part, i) => (i % 2 ? h("code", {}, part) : part));
