// Keys, sounds, and the journal's lines as they come. All that is shown comes from the server: without
// a stream of events the page asks every two seconds by itself (hx-trigger in the pages).
"use strict";

const LINES_SHOWN = 200;
const MUTED = "lightstage-muted";

// --- sounds ---------------------------------------------------------------------------------------
// Pitch in Hz and length in seconds, one after the other. A browser lets a page sound after a first key or click.
const SOUNDS = {
  hold: [[392, 0.45]],
  done: [[523, 0.15], [784, 0.3]],
  look: [[880, 0.12], [0, 0.08], [880, 0.12], [0, 0.08], [880, 0.12]],
};
let audio = null;

function muted() {
  return localStorage.getItem(MUTED) === "yes";
}

function unlock() {
  if (!muted() && audio === null) audio = new AudioContext();
}

function play(name) {
  document.body.dataset.sound = name; // also what a test can see
  if (muted() || audio === null || !(name in SOUNDS)) return;
  let at = audio.currentTime + 0.02;
  for (const [pitch, length] of SOUNDS[name]) {
    if (pitch) {
      const tone = audio.createOscillator();
      const loud = audio.createGain();
      tone.frequency.value = pitch;
      loud.gain.setValueAtTime(0, at);
      loud.gain.linearRampToValueAtTime(0.25, at + 0.02);
      loud.gain.linearRampToValueAtTime(0, at + length);
      tone.connect(loud).connect(audio.destination);
      tone.start(at);
      tone.stop(at + length);
    }
    at += length;
  }
}

function showSounds() {
  const button = document.getElementById("sounds");
  button.setAttribute("aria-pressed", String(!muted()));
  button.firstChild.textContent = muted() ? "Sounds off " : "Sounds on ";
}

// --- keys -----------------------------------------------------------------------------------------
const PAGES = { 1: "/plan", 2: "/live", 3: "/devices", 4: "/sessions" };

function pressed(event) {
  unlock();
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
  if (event.target.matches("input, textarea, select")) return;
  const look = document.getElementById("look");
  // A stop works from everywhere; other keys belong to what lies on top.
  const button = document.querySelector(`[data-key="${CSS.escape(event.key)}"]`);
  if (look.open && event.key !== "q") return;
  if (button !== null && button.dataset.says) {
    event.preventDefault();
    document.getElementById("said").textContent = button.dataset.says;
  } else if (button !== null) {
    event.preventDefault();
    button.click();
  } else if (event.key in PAGES) {
    location.assign(PAGES[event.key]);
  }
}

// --- events ---------------------------------------------------------------------------------------
function follow(part) {
  let waiting = 0;
  // From the first line that is remembered on: the list below shows what happened before, without a sound.
  const shown = Number(part.dataset.after);
  const stream = new EventSource(`${part.dataset.events}?after=0`);
  stream.onmessage = (event) => {
    const told = JSON.parse(event.data);
    if (told.sound && told.id > shown) play(told.sound);
    if (told.text && told.tone !== "quiet") write(told);
    // Several lines within a moment are one look.
    if (!waiting && !(told.id <= shown)) {
      waiting = setTimeout(() => {
        waiting = 0;
        htmx.trigger(part, "stage");
      }, 150);
    }
  };
  addEventListener("pagehide", () => stream.close());
}

function write(told) {
  const list = document.getElementById("log");
  const line = document.createElement("li");
  line.textContent = `${told.at} ${told.sign} ${told.text.replace(/\.$/, "")}${told.todo ? ". " + told.todo : ""}`;
  list.prepend(line);
  while (list.children.length > LINES_SHOWN) list.lastChild.remove();
}

// What a page shows is old once the console does not answer, or knows this page no longer.
function lost(why) {
  for (const id of ["lost", "unknown"]) document.getElementById(id).hidden = id !== why;
  document.body.classList.toggle("old", why !== "");
}

// What was pressed is sent before the page is left: a stop must not be lost on the way.
let sending = 0;
let going = "";
function leave(url) {
  going = url;
  if (!sending) location.assign(url);
  else setTimeout(() => location.assign(url), 2000);
}
function counted(by) {
  return (event) => {
    if (event.detail.requestConfig.verb !== "post") return;
    sending += by;
    if (!sending && going) location.assign(going);
  };
}

// A word on what was pressed ends with the state that it was said of.
let phase = "";
function forget() {
  const banner = document.querySelector("[data-phase]");
  const now = banner === null ? "" : banner.dataset.phase;
  if (now !== phase && phase !== "") document.getElementById("said").textContent = "";
  phase = now;
}

document.addEventListener("DOMContentLoaded", () => {
  showSounds();
  document.getElementById("sounds").addEventListener("click", () => {
    localStorage.setItem(MUTED, muted() ? "no" : "yes");
    unlock();
    showSounds();
  });
  addEventListener("keydown", pressed);
  addEventListener("pointerdown", unlock);
  const part = document.querySelector("[data-events]");
  if (part !== null) follow(part);
  document.body.addEventListener("htmx:sendError", () => lost("lost"));
  document.body.addEventListener("htmx:afterOnLoad", (event) => lost(event.detail.xhr.status === 401 ? "unknown" : ""));
  document.body.addEventListener("htmx:beforeRequest", counted(1));
  document.body.addEventListener("htmx:afterRequest", counted(-1));
  forget();
  document.body.addEventListener("htmx:afterSwap", (event) => {
    forget();
    const look = document.getElementById("look");
    if (event.detail.target === look && !look.open) look.showModal();
    // A capture on its way has begun: its own page has what this one lacks.
    if (location.pathname === "/live" && event.detail.target.id === "part" && event.detail.xhr.responseURL.includes("/session/")) {
      leave(event.detail.xhr.responseURL);
    }
  });
});
