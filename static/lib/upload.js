// Resumable uploads: in chunks, each acknowledged once it is on disk; a lost connection is taken up where it broke.

import { api, Problem, request } from "./api.js";

const CHUNK = 8 << 20;
const PATIENCE = [500, 1000, 2000, 4000, 8000, 15_000, 30_000];

const wait = (ms, signal) =>
  new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, ms);
    signal?.addEventListener("abort", () => (clearTimeout(timer), reject(signal.reason)), { once: true });
  });

/** What the same file left behind when its page was closed. */
const memory = {
  key: (file) => `upload:${file.name}:${file.size}:${file.lastModified ?? 0}`,
  get: (file) => localStorage.getItem(memory.key(file)),
  set: (file, id) => localStorage.setItem(memory.key(file), id),
  drop: (file) => localStorage.removeItem(memory.key(file)),
};

async function begin(file, options) {
  const known = memory.get(file);
  if (known) {
    try {
      return await api(`uploads/${known}`);
    } catch {
      memory.drop(file);
    }
  }
  const upload = await api("uploads", { json: { file_name: file.name, size: file.size, ...options } });
  memory.set(file, upload.id);
  return upload;
}

async function sendChunk(upload, file, offset, signal) {
  const response = await request(`uploads/${upload.id}`, {
    method: "PATCH",
    headers: { "Upload-Offset": String(offset), "Content-Type": "application/octet-stream" },
    body: file.slice(offset, offset + CHUNK),
    signal,
  });
  return (await response.json()).received;
}

/** Where to go on after a failure, or the error itself where trying again would not help. */
async function recover(upload, error, failures, signal, onWait) {
  const temporary = error.status === 0 || error.status === 409 || error.status === 429 || error.status >= 502;
  if (!(error instanceof Problem) || !temporary || error.status === 507 || failures >= PATIENCE.length) throw error;
  if (error.status !== 409) {
    onWait?.(PATIENCE[failures]);
    await wait(PATIENCE[failures], signal);
  }
  try {
    return (await api(`uploads/${upload.id}`, { signal })).received;
  } catch (again) {
    if (again.status === 404) throw error;
    return null;
  }
}

/**
 * Sends a File or Blob with a name; resolves with the Upload once all bytes are on the server's disk.
 * `onProgress(received, size)`, `onWait(ms)` while the connection is lost; `signal` stops it.
 */
export async function upload(file, options, { onProgress, onWait, signal } = {}) {
  const started = await begin(file, options);
  let offset = started.received;
  let failures = 0;
  onProgress?.(offset, file.size);
  while (offset < file.size) {
    signal?.throwIfAborted();
    try {
      offset = await sendChunk(started, file, offset, signal);
      failures = 0;
    } catch (error) {
      const known = await recover(started, error, failures, signal, onWait);
      failures += 1;
      if (known !== null) offset = known;
    }
    onProgress?.(offset, file.size);
  }
  return started;
}

/** The table's columns, their types, first rows and a guess at what they are. */
export const columns = (id) => api(`uploads/${id}/columns`);

/** Starts reading the file, `how`: {mapping, in_order}; resolves with the job. */
export async function finish(file, id, how = {}) {
  const job = await api(`uploads/${id}/finish`, { json: how });
  memory.drop(file);
  return job;
}

export async function abandon(file, id) {
  memory.drop(file);
  if (id) await api(`uploads/${id}`, { method: "DELETE" }).catch(() => {});
}

