"use strict";
// The headset's side of `webxr`: one binary message for each of its frames, as of frames.py.

const PARTS = { head: 0, left_hand: 1, right_hand: 26, left_controller: 51, right_controller: 52, left_aim: 53, right_aim: 54 };
const NAMES = Object.keys(PARTS);
const NOTHING = { antialias: false, depth: false, framebufferScaleFactor: 0.25 }; // is drawn
const MOST_QUEUED = 8192; // bytes: who falls behind skips frames

const message = new ArrayBuffer(1652);
const head = new DataView(message);
const poses = new Float32Array(message, 16, 55 * 7);
const buttons = new Float32Array(message, 16 + 4 * 55 * 7, 16);
const axes = new Float32Array(message, 16 + 4 * (55 * 7 + 16), 8);

const at = (id) => document.getElementById(id);
let socket = null, session = null, space = null, gl = null;
let number = 0, sent = 0, dropped = 0, flags = 0;

function say(text, kind = "") {
  at("status").textContent = text;
  at("status").className = kind;
}

function put(place, pose) {
  if (!pose) return false;
  const { position: p, orientation: q } = pose.transform;
  poses.set([p.x, p.y, p.z, q.x, q.y, q.z, q.w], 7 * place);
  return true;
}

function putHand(frame, hand, part) {
  let place = PARTS[part];
  for (const joint of hand.values()) // 25, in the standard's order
    if (!put(place++, frame.getJointPose(joint, space))) return;
  flags |= 1 << NAMES.indexOf(part);
}

function putOne(part, pose) {
  if (put(PARTS[part], pose)) flags |= 1 << NAMES.indexOf(part);
}

function putController(frame, source, side) {
  if (source.gripSpace) putOne(`${side}_controller`, frame.getPose(source.gripSpace, space));
  const row = side === "left" ? 0 : 1, { gamepad } = source;
  const within = (value, low) => Math.min(Math.max(value, low), 1);
  buttons.set(gamepad.buttons.slice(0, 8).map(({ value }) => within(value, 0)), 8 * row);
  axes.set(gamepad.axes.slice(0, 4).map((value) => within(value, -1)), 4 * row);
}

function onFrame(_, frame) {
  const now = performance.now();
  session.requestAnimationFrame(onFrame);
  gl.bindFramebuffer(gl.FRAMEBUFFER, session.renderState.baseLayer.framebuffer);
  gl.clear(gl.COLOR_BUFFER_BIT);
  flags = 0;
  buttons.fill(0);
  axes.fill(0);
  putOne("head", frame.getViewerPose(space));
  for (const source of session.inputSources) {
    const side = source.handedness;
    if (side !== "left" && side !== "right") continue;
    if (source.hand) putHand(frame, source.hand, `${side}_hand`);
    else if (source.gamepad) putController(frame, source, side);
    putOne(`${side}_aim`, frame.getPose(source.targetRaySpace, space));
  }
  head.setUint16(0, 1, true);
  head.setUint16(2, flags, true);
  head.setUint32(4, number++, true);
  head.setFloat64(8, now, true);
  if (socket && socket.readyState === WebSocket.OPEN && socket.bufferedAmount < MOST_QUEUED) {
    socket.send(message);
    sent += 1;
  } else {
    dropped += 1;
  }
}

function connect() {
  return new Promise((resolve, reject) => {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const opened = new WebSocket(`${scheme}//${location.host}/poses${location.search}`);
    opened.binaryType = "arraybuffer";
    opened.onopen = () => resolve(opened);
    opened.onmessage = ({ data }) => { // the other side's time: answered with ours
      const answer = new ArrayBuffer(16);
      new Uint8Array(answer).set(new Uint8Array(data, 0, 8));
      new DataView(answer).setFloat64(8, performance.now(), true);
      opened.send(answer);
    };
    opened.onclose = ({ reason }) => {
      const why = reason || "the robot's computer does not answer";
      reject(new Error(why));
      if (socket !== opened) return;
      socket = null;
      if (session) {
        session.end().catch(() => undefined);
        say(`Disconnected: ${why}.`, "bad");
      }
    };
  });
}

async function start() {
  at("start").disabled = true;
  try {
    const mode = await navigator.xr.isSessionSupported("immersive-ar") ? "immersive-ar" : "immersive-vr";
    const begun = await navigator.xr.requestSession(mode, {
      requiredFeatures: ["local-floor"],
      optionalFeatures: ["hand-tracking"],
    });
    begun.addEventListener("end", () => ended(begun));
    session = begun;
    number = sent = dropped = 0;
    gl = document.createElement("canvas").getContext("webgl", { xrCompatible: true, antialias: false, depth: false });
    if (!gl) throw new Error("this browser has no WebGL");
    gl.clearColor(0, 0, 0, 0);
    await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl, NOTHING) });
    space = await session.requestReferenceSpace("local-floor");
    socket = await connect();
    if (session !== begun) return;
    say("Connected: the robot's computer hears this headset.", "good");
    at("start").textContent = "Stop";
    session.requestAnimationFrame(onFrame);
  } catch (error) {
    say(`It did not start: ${error.message}.`, "bad");
    if (session) session.end().catch(() => undefined);
  }
  at("start").disabled = false;
}

function ended(which) {
  if (session !== which) return;
  session = null;
  flags = 0;
  const open = socket;
  socket = null;
  if (open) {
    open.close(1000, "the session ended");
    say("Stopped: nothing is sent.");
  }
  at("start").textContent = "Start";
}

function show() {
  at("rate").textContent = sent;
  sent = 0;
  at("dropped").textContent = dropped;
  for (const name of NAMES) {
    const cell = at(name);
    if (cell) cell.textContent = !session ? "–" : flags & (1 << NAMES.indexOf(name)) ? "tracked" : "not seen";
  }
}

async function look() {
  if (!window.isSecureContext) return say("Open this page by https: browsers show headsets to no others.", "bad");
  if (!navigator.xr) return say("This browser has no WebXR. Open this page in the headset's browser.", "bad");
  const found = await navigator.xr.isSessionSupported("immersive-vr") || await navigator.xr.isSessionSupported("immersive-ar");
  if (!found) return say("No headset is connected to this browser.", "bad");
  say("Ready. Press Start, and allow hand tracking if you are asked.");
  at("start").disabled = false;
}

at("start").addEventListener("click", () => (session ? session.end() : start()));
addEventListener("pagehide", () => { if (socket) socket.close(1000, "the page was closed"); });
setInterval(show, 1000);
look().catch((error) => say(`No headset: ${error.message}.`, "bad"));
