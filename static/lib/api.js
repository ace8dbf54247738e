// The REST interface. Every failure becomes a Problem (RFC 9457), so that a page can put it where the mistake is.

import { h } from "./dom.js";
import { unpack } from "./packed.js";

export const API = "/api/v1";

export class Problem extends Error {
  constructor(body, status) {
    super(body.detail || body.title || `The server answered ${status}.`);
    this.name = "Problem";
    this.status = status;
    this.title = body.title ?? "Error";
    this.code = body.code ?? "error";
    this.where = body.where ?? {};
    this.body = body;
  }
}

const OFFLINE = { title: "No connection", code: "offline", detail: "The server does not answer. Is it still running?" };

async function problem(response) {
  let body = {};
  try {
    body = await response.json();
  } catch {
    body = { detail: `${response.status} ${response.statusText}` };
  }
  return new Problem(body, response.status);
}

/** fetch() that throws a Problem for every answer that is not a success, and for none at all. */
export async function request(path, options = {}) {
  let response;
  try {
    response = await fetch(path.startsWith("/") ? path : `${API}/${path}`, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(OFFLINE, 0);
  }
  if (!response.ok) throw await problem(response);
  return response;
}

/** JSON in, JSON out: api("runs"), api("runs/1", {method: "PATCH", json: {...}}); null where there is no content. */
export async function api(path, { json, ...options } = {}) {
  if (json !== undefined) {
    options.body = JSON.stringify(json);
    options.headers = { ...options.headers, "Content-Type": "application/json" };
    options.method ??= "POST";
  }
  const response = await request(path, options);
  return response.status === 204 ? null : response.json();
}

/** JSON in, an answer in one block of bytes out (packed.js). */
export async function packed(path, json, { signal } = {}) {
  const headers = { "Content-Type": "application/json", Accept: "application/octet-stream" };
  return unpack(await (await request(path, { method: "POST", body: JSON.stringify(json), headers, signal })).arrayBuffer());
}

/** A query string of what is given. */
export function query(params) {
  const pairs = Object.entries(params).filter(([, v]) => v !== undefined && v !== null && v !== "");
  return new URLSearchParams(pairs).toString();
}

const WHERE = ["file", "stream", "row", "column", "line", "expected", "found", "method", "missing", "parameter"];

const text = (value) => (Array.isArray(value) ? value.map(text).join(", ") : typeof value === "number" ? String(Number(value.toPrecision(6))) : typeof value === "object" ? JSON.stringify(value) : String(value));

/** A Problem (or its body) as an element that says what is wrong, where, what was expected and what was found. */
export function problemNote(error, ...more) {
  const where = error.where ?? {};
  const known = WHERE.filter((k) => where[k] !== undefined && where[k] !== null);
  return h(
    "div",
    { class: "note red", role: "alert", "data-code": error.code ?? "error" },
    h("p", {}, error.detail ?? error.message ?? "Something went wrong."),
    known.length > 0 &&
      h("div", { class: "where" }, known.map((k) => h("span", { "data-where": k }, h("span", { class: "dim" }, `${k} `), text(where[k])))),
    ...more,
  );
}
