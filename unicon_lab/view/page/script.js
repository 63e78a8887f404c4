// What viser's page lacks: a large e-stop, a heartbeat, gamepad and keys.
// Runs in the page at each connection, with `given`: {stop, live, beat}, ids of its widgets.
const page = (window.uniconPage ??= { stops: 0, held: new Set() });
Object.assign(page, given);
page.asked = performance.now();
if (!page.ready) {
  page.ready = true;
  // viser tries to connect again only while its window is in front.
  document.hasFocus = () => true;

  const KEYS = { i: [0, 1], k: [0, -1], u: [1, 1], o: [1, -1], j: [2, 1], l: [2, -1] };
  const typing = (event) => /^(INPUT|TEXTAREA|SELECT)$/.test(event.target?.tagName ?? "")
    && event.target.type !== "range";
  addEventListener("keydown", (event) => {
    if (typing(event) || event.ctrlKey || event.metaKey || event.altKey) return;
    page.fast = event.shiftKey;
    if (event.key.toLowerCase() in KEYS) page.held.add(event.key.toLowerCase());
  });
  addEventListener("keyup", (event) => {
    page.fast = event.shiftKey;
    page.held.delete(event.key.toLowerCase());
  });
  // viser prevents the default of a drag in a passive listener, which browsers call an error.
  addEventListener("pointerdown", (event) => {
    if (event.target.tagName === "CANVAS") event.preventDefault = () => {};
  }, true);
  addEventListener("blur", () => page.held.clear());
  document.addEventListener("visibilitychange", () => page.held.clear());

  const stick = (x) => (Math.abs(x) < 0.1 ? 0 : (x - Math.sign(x) * 0.1) / 0.9);
  const state = () => {
    const pad = [...navigator.getGamepads()].find((each) => each?.connected && each.axes.length > 2);
    const device = pad
      ? [-stick(pad.axes[1]), -stick(pad.axes[0]), -stick(pad.axes[2])]
      : [0, 0, 0];
    for (const key of page.held) {
      const [axis, sign] = KEYS[key];
      device[axis] = sign * (page.fast ? 1 : 0.5);
    }
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    return { hidden: document.hidden, stops: page.stops, pad: pad?.id ?? "", device, dark };
  };
  const send = (uuid, value) => window.__viserMutable?.sendMessage?.({
    type: "GuiUpdateMessage", uuid, updates: { value },
  });
  // Without a line, viser has a function in its place that says so on the console.
  const line = () => window.__viserMutable && !/not connected/.test(window.__viserMutable.sendMessage);
  const alive = () => line() && performance.now() - page.asked < 3000;
  let told = "", when = 0, count = 0;
  page.tell = () => {
    const now = performance.now(), text = JSON.stringify(state());
    if (!page.beat || !alive() || (text === told && now - when < 100)) return;
    [told, when, count] = [text, now, count + 1];
    send(page.beat, `${count} ${text}`);
  };
  setInterval(page.tell, 25);
  document.addEventListener("visibilitychange", page.tell);

  // The server asks for a key of the storage behind each picture: so it knows what we have drawn.
  const get = Storage.prototype.getItem;
  Storage.prototype.getItem = function (key) {
    if (key.endsWith(":unicon")) page.asked = performance.now();
    return get.call(this, key);
  };

  // On a phone the sheet of widgets leaves the upper part of the page to the robot.
  const style = document.createElement("style");
  style.textContent = `
    #unicon-bar { position: fixed; top: 8px; z-index: 100000; display: flex; gap: 8px;
      width: max-content; transform: translateX(-50%); font: 13px/1.3 system-ui, sans-serif }
    #unicon-estop { height: 54px; border-radius: 10px; border: 3px solid #fff; color: #fff;
      font: bold 22px system-ui, sans-serif; box-shadow: 0 2px 8px #0008; cursor: pointer;
      padding: 0 14px; white-space: nowrap }
    #unicon-status { max-height: 54px; overflow: hidden; padding: 4px 10px; border-radius: 10px;
      background: var(--mantine-color-body); white-space: pre-line; align-self: center }
    #unicon-past { position: absolute; top: 60px; left: 50%; transform: translateX(-50%);
      height: 32px; border: 0; border-radius: 10px; background: #e8590c; color: #fff;
      font: bold 14px system-ui, sans-serif; padding: 0 14px; white-space: nowrap; cursor: pointer }
    @media (max-width: 576px) {
      [style*="width: 20em"] { width: 100% !important }
      [style*="max-height: 60%"] { max-height: 42% !important }
    }`;
  document.head.append(style);
  const bar = document.createElement("div");
  bar.id = "unicon-bar";
  bar.innerHTML = `<button id="unicon-estop"></button><div id="unicon-status"></div>
    <button id="unicon-past" title="Shows the past: click for the present"></button>`;
  const [button, status, past] = bar.children;
  past.onclick = () => send(page.live, true);
  page.brief = (text, fault, over, ago) => {
    status.textContent = text;
    past.textContent = ago;
    page.over = over;
    status.style.color = fault ? "#e03131" : "";
  };
  button.onclick = () => {
    page.stops += 1; // told with the heartbeats too
    send(page.stop, true);
    page.look();
  };
  document.body.append(bar);
  page.look = () => {
    const hears = alive(), views = [...document.querySelectorAll("canvas")];
    const view = views.map((each) => each.getBoundingClientRect())
      .reduce((one, other) => (other.width * other.height > one.width * one.height ? other : one),
        { left: 0, width: innerWidth, height: 0 });
    bar.style.left = `${view.left + view.width / 2}px`;
    bar.style.maxWidth = `${view.width - 12}px`;
    status.style.display = status.textContent && hears ? "" : "none";
    button.style.display = page.stop ? "" : "none";
    past.style.display = past.textContent && hears ? "" : "none";
    button.style.background = !hears || page.over ? "#777" : page.stops ? "#7a0b0b" : "#d40000";
    button.textContent = !hears ? "NO CONNECTION" : page.over ? "RUN HAS ENDED" : page.stops ? "E-STOP pressed" : "E-STOP";
    button.title = hears
      ? "Ends the run and damps the robot at once"
      : "The robot does not hear this page: use its own emergency stop";
  };
  setInterval(page.look, 200);
}
page.stops = 0;
page.held.clear();
page.look();
