"use strict";
// The headset's side of `webxr`: one binary message for each of its frames, as of frames.py.

const PARTS = { head: 0, left_hand: 1, right_hand: 26, left_controller: 51, right_controller: 52, left_aim: 53, right_aim: 54 };
const NAMES = Object.keys(PARTS);
const CAMERAS = +document.body.dataset.cameras;
const LAYER = { antialias: false, depth: false, framebufferScaleFactor: CAMERAS ? 1 : 0.25 };
const MOST_QUEUED = 8192; // bytes: who falls behind skips frames

const message = new ArrayBuffer(1652);
const head = new DataView(message);
const poses = new Float32Array(message, 16, 55 * 7);
const buttons = new Float32Array(message, 16 + 4 * 55 * 7, 16);
const axes = new Float32Array(message, 16 + 4 * (55 * 7 + 16), 8);

const at = (id) => document.getElementById(id);
let socket = null, session = null, space = null, gl = null;
let number = 0, sent = 0, dropped = 0, flags = 0;
let note = "", paint = null;

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

// Pictures: asked for one at a time, drawn with their age into a canvas, which is the texture, too.
const STALE = 500, WIDE = 1.6, FAR = -1.5; // ms; m, of the picture that moves with the head
const eyes = [];

const address = (path) => `${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}${path}${location.search}`;

function watch(index) {
  const eye = eyes[index], opened = new WebSocket(address(`/camera/${index}`));
  let asked = 0;
  const ask = () => {
    asked = performance.now();
    if (opened.readyState === WebSocket.OPEN) opened.send("");
  };
  opened.binaryType = "arraybuffer";
  opened.onopen = ask;
  opened.onclose = () => setTimeout(watch, 1000, index);
  opened.onmessage = async ({ data }) => {
    if (typeof data === "string") return void (note = data);
    const head = new DataView(data);
    try {
      const picture = await createImageBitmap(new Blob([new Uint8Array(data, 12)]));
      if (eye.picture) eye.picture.close();
      // The way here counts as long as it can have been.
      const born = asked + head.getFloat32(8, true) - head.getFloat32(4, true);
      Object.assign(eye, { picture, born, number: head.getUint32(0, true) });
      drawEye(eye);
    } catch { /* a torn picture: the next one */ }
    ask();
  };
}

function drawEye(eye) {
  const { canvas, pen, picture } = eye, age = eye.drawn = performance.now();
  if (picture && canvas.width !== picture.width) Object.assign(canvas, { width: picture.width, height: picture.height });
  const { width, height } = canvas, old = age - eye.born, stale = !(old < STALE);
  if (picture) pen.drawImage(picture, 0, 0);
  pen.strokeStyle = pen.fillStyle = stale ? "#e00" : "#000a";
  pen.lineWidth = 24;
  if (stale) pen.strokeRect(0, 0, width, height);
  pen.fillRect(0, height - 28, width, 28);
  pen.fillStyle = "#fff";
  pen.font = "20px sans-serif";
  pen.fillText(`${picture ? `${stale ? "STALE " : ""}${old.toFixed(0)} ms` : "no picture yet"}  ${note}`, 8, height - 8);
  eye.fresh = true;
}

function painter() {
  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, "attribute vec2 at; uniform mat4 see, view, head; uniform vec3 size; varying vec2 place;"
      + "void main() { place = vec2(at.x, 1. - at.y); gl_Position = see * view * head * vec4((at - .5) * size.xy, size.z, 1.); }"],
    [gl.FRAGMENT_SHADER, "precision mediump float; uniform sampler2D picture; varying vec2 place;"
      + "void main() { gl_FragColor = texture2D(picture, place); }"],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "at");
  gl.linkProgram(program);
  gl.useProgram(program);
  const [see, view, head, size] = ["see", "view", "head", "size"].map((name) => gl.getUniformLocation(program, name));
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([0, 0, 1, 0, 0, 1, 1, 1]), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
  for (const eye of eyes) {
    gl.bindTexture(gl.TEXTURE_2D, eye.texture = gl.createTexture());
    for (const edge of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, edge, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    eye.fresh = true;
  }
  return (pose, layer) => {
    for (const each of pose.views) {
      const eye = eyes[each.eye === "right" ? eyes.length - 1 : 0], { canvas } = eye;
      const { x, y, width, height } = layer.getViewport(each);
      gl.viewport(x, y, width, height);
      gl.bindTexture(gl.TEXTURE_2D, eye.texture);
      if (performance.now() - eye.drawn > 100) drawEye(eye);
      if (eye.fresh) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
      eye.fresh = false;
      gl.uniformMatrix4fv(see, false, each.projectionMatrix);
      gl.uniformMatrix4fv(view, false, each.transform.inverse.matrix);
      gl.uniformMatrix4fv(head, false, pose.transform.matrix);
      gl.uniform3f(size, WIDE, WIDE * canvas.height / canvas.width, FAR);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
  };
}

for (let index = 0; index < CAMERAS; index++) {
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: 640, height: 480 });
  eyes.push({ canvas, pen: at("cameras").appendChild(canvas).getContext("2d", { willReadFrequently: true, alpha: false }), born: NaN, drawn: 0 });
  watch(index);
}
setInterval(() => eyes.forEach(drawEye), 100);

function onFrame(_, frame) {
  const now = performance.now();
  session.requestAnimationFrame(onFrame);
  const layer = session.renderState.baseLayer, pose = frame.getViewerPose(space);
  gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
  gl.clear(gl.COLOR_BUFFER_BIT);
  flags = 0;
  buttons.fill(0);
  axes.fill(0);
  putOne("head", pose);
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
  if (paint && pose) paint(pose, layer);
}

function connect() {
  return new Promise((resolve, reject) => {
    const opened = new WebSocket(address("/poses"));
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
    await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl, LAYER) });
    paint = CAMERAS ? painter() : null;
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
