// The 3D view in a page: an iframe of its own viewer, moved by the page's time cursor.
//
//   const scene = mountScene(container, runId, clock, { methods: ["fused", "encoders"] });
//   scene.setMethods([...]) | scene.setTrail("speed") | scene.reload() | scene.address | scene.state | scene.dispose()
//   live: true shows the newest moment of a run that still goes on, and leaves all keys to the page (they drive).
//
// Events on `container`: "scene-ready" when the picture is there, "scene-problem" (detail: the problem) when it can't be;
// `data-scene` on it says the same: opening, ready, problem.
// Only what changes is sent (protocol: app/scene/__init__.py): while the cursor plays, the server moves the robots by
// its own clock at 30 Hz, and a word once a second keeps the two together.

import { onThemeChange } from "./palette.js";

const SEND_EVERY = 33; // ms, while the cursor is dragged
const ANCHOR_EVERY = 1000; // ms, while it plays
const DRIFT = 0.12; // s of wall time between page and scene before a word is sent
const RETRY = [500, 1000, 2000, 5000, 10000]; // ms
const SCENE_KEYS = new Set(["w", "a", "s", "d", "q", "e", "ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", "Tab"]);

export function mountScene(container, runId, clock, { methods = null, query = "", live = false, trail = "method" } = {}) {
  const viewer = newKey();
  const address = `/scene/${encodeURIComponent(runId)}/${viewer}/`;
  const note = document.createElement("p");
  let frame = null;
  let socket = null;
  let shown = methods;
  let colouring = trail; // of the leading path of a live run: method, speed, gap
  let anchor = { t: clock.time, at: performance.now(), rate: 0 };
  let timer = 0;
  let retry = 0;
  let attempts = 0;
  let lonely = 0;
  let ready = false;
  let disposed = false;
  const handle = { address, state: null, setMethods, setTrail, reload, dispose };

  note.setAttribute("role", "status");
  note.textContent = "Opening the 3D view …";
  Object.assign(note.style, {
    position: "absolute", left: "12px", bottom: "8px", margin: "0", fontSize: "var(--size-s)", color: "var(--ink-3)",
    pointerEvents: "none",
  }); // prettier-ignore
  if (getComputedStyle(container).position === "static") container.style.position = "relative";
  container.append(note);
  container.dataset.scene = "opening";

  // The page comes first: neither frame nor socket before it is painted and the view is in sight.
  const sight = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    sight.disconnect();
    requestAnimationFrame(() => setTimeout(open, 0));
  }, { rootMargin: "400px" });
  sight.observe(container);
  const forgetClock = clock.subscribe(moved);
  const forgetTheme = onThemeChange(() => send({ theme: theme() }));

  function open() {
    if (disposed) return;
    connect();
    frame = document.createElement("iframe");
    frame.title = "3D view";
    frame.src = `${address}?hideViserLogo&theme=${theme()}${query}`;
    Object.assign(frame.style, { border: "0", width: "100%", height: "100%", display: "block", opacity: "0" });
    frame.addEventListener("load", passKeys);
    container.prepend(frame);
  }

  function connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const path = `/api/v1/scenes/${encodeURIComponent(runId)}/cursor?viewer=${viewer}`;
    socket = new WebSocket(`${scheme}//${location.host}${path}`);
    socket.addEventListener("open", () => {
      attempts = 0;
      sendAll();
    });
    socket.addEventListener("message", (event) => heard(JSON.parse(event.data)));
    socket.addEventListener("close", (event) => {
      socket = null;
      if (disposed || event.code === 4404) return;
      retry = setTimeout(connect, RETRY[Math.min(attempts++, RETRY.length - 1)]);
    });
  }

  function heard(message) {
    if (message.type === "problem") {
      note.textContent = message.detail;
      if (!ready) container.dataset.scene = "problem";
      container.dispatchEvent(new CustomEvent("scene-problem", { detail: message }));
      return;
    }
    handle.state = message;
    if (message.by === "panel") followPanel(message);
    clearTimeout(lonely);
    if (message.clients > 0) show(message);
    else if (ready) lonely = setTimeout(reload, 3000); // the server forgot us (restarted): viser waits for a click
  }

  function show(message) {
    ready = true;
    container.dataset.scene = "ready";
    frame.style.opacity = "1";
    note.textContent = message.robot_scale > 1 ? `robots drawn ${message.robot_scale.toFixed(1)}× larger` : "";
    container.dispatchEvent(new CustomEvent("scene-ready", { detail: message }));
  }

  // The same viewer opened in another tab with viser's own panel: its hand moves this page too.
  function followPanel({ t, playing, speed, follow }) {
    anchor = { t, at: performance.now(), rate: playing ? speed : 0 };
    if (speed !== clock.speed) clock.setSpeed(speed);
    if (follow !== clock.follow) clock.setFollow(follow);
    clock.setTime(t);
    if (playing !== clock.playing) clock.toggle();
  }

  function moved(what) {
    if (what === "time") live || onTime();
    else if (what === "play" || what === "speed" || what === "follow") sendCursor();
  }

  function onTime() {
    if (!clock.playing) {
      if (!timer) timer = setTimeout(sendCursor, SEND_EVERY);
      return;
    }
    const passed = (performance.now() - anchor.at) / 1000;
    const apart = Math.abs(anchor.t + passed * anchor.rate - clock.time);
    if (apart > DRIFT * clock.speed || passed * 1000 > ANCHOR_EVERY) sendCursor();
  }

  function sendCursor() {
    clearTimeout(timer);
    timer = 0;
    anchor = { t: clock.time, at: performance.now(), rate: clock.playing ? clock.speed : 0 };
    send(live ? { follow: clock.follow } : { t: clock.time, playing: clock.playing, speed: clock.speed, follow: clock.follow });
  }

  function sendAll() {
    send({ theme: theme(), methods: shown, trail: colouring });
    sendCursor();
  }

  function send(change) {
    if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(change));
  }

  function setTrail(name) {
    colouring = name;
    send({ trail: colouring });
  }

  // null: all. Names that the scene doesn't know are ignored there.
  function setMethods(list) {
    shown = list === null ? null : [...list];
    send({ methods: shown });
  }

  // A fresh scene, with what has been estimated meanwhile.
  function reload() {
    if (!frame || disposed) return;
    frame.contentWindow.location.reload();
    socket?.close();
  }

  // The page's keys work while the 3D view has the focus; those that move viser's camera stay there.
  function passKeys() {
    const pass = (event) => {
      const { type, key, code, ctrlKey, metaKey, altKey, shiftKey, repeat } = event;
      if ((SCENE_KEYS.has(key) && !live) || ctrlKey || metaKey || altKey || isField(event.target)) return;
      document.body.dispatchEvent(new KeyboardEvent(type, { key, code, shiftKey, repeat, bubbles: true }));
      if (live) event.stopPropagation();
      if (live || key === " ") event.preventDefault();
    };
    for (const type of ["keydown", "keyup"]) frame.contentWindow.addEventListener(type, pass, { capture: live });
  }

  function dispose() {
    disposed = true;
    sight.disconnect();
    forgetClock();
    forgetTheme();
    for (const id of [timer, retry, lonely]) clearTimeout(id);
    socket?.close();
    frame?.remove();
    note.remove();
    delete container.dataset.scene;
  }

  return handle;
}

function newKey() {
  return [...crypto.getRandomValues(new Uint8Array(12))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

function theme() {
  return getComputedStyle(document.documentElement).colorScheme.includes("dark") ? "dark" : "light";
}

function isField(target) {
  return target instanceof Element && target.closest("input, textarea, select") !== null;
}
