// What viser's page lacks: a large e-stop, gamepad and keys, and an answer that tells of them.
// Runs in the page at each connection, with `given`: {key, stop}.
const page = (window.uniconPage ??= { stops: 0, held: new Set() });
page.stop = given.stop;
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
  addEventListener("blur", () => page.held.clear());
  document.addEventListener("visibilitychange", () => page.held.clear());

  const stick = (x) => (Math.abs(x) < 0.1 ? 0 : (x - Math.sign(x) * 0.1) / 0.9);
  page.state = () => {
    page.asked = performance.now();
    const pad = [...navigator.getGamepads()].find((each) => each?.connected && each.axes.length > 2);
    const device = pad
      ? [-stick(pad.axes[1]), -stick(pad.axes[0]), -stick(pad.axes[2])]
      : [0, 0, 0];
    for (const key of page.held) {
      const [axis, sign] = KEYS[key];
      device[axis] = sign * (page.fast ? 1 : 0.5);
    }
    return { hidden: document.hidden, stops: page.stops, pad: pad?.id ?? "", device };
  };
  const get = Storage.prototype.getItem;
  Storage.prototype.getItem = function (key) {
    return key === given.key ? JSON.stringify(page.state()) : get.call(this, key);
  };

  const button = document.createElement("button");
  button.id = "unicon-estop";
  button.style.cssText = "position:fixed;top:8px;left:50%;transform:translateX(-50%);z-index:100000;"
    + "min-width:230px;height:58px;border-radius:10px;border:3px solid #fff;color:#fff;"
    + "font:bold 24px system-ui,sans-serif;box-shadow:0 2px 8px #0008;cursor:pointer;padding:0 18px";
  button.onclick = () => {
    page.stops += 1; // told with the next answer, and at once by viser's own button:
    window.__viserMutable?.sendMessage?.({
      type: "GuiUpdateMessage", uuid: page.stop, updates: { value: true },
    });
    look();
  };
  document.body.append(button);
  const look = () => {
    const alive = performance.now() - page.asked < 1500;
    button.hidden = !page.stop;
    button.style.display = page.stop ? "" : "none";
    button.style.background = !alive ? "#777" : page.stops ? "#7a0b0b" : "#d40000";
    button.textContent = !alive ? "NO CONNECTION" : page.stops ? "E-STOP pressed" : "E-STOP";
    button.title = alive
      ? "Ends the run and damps the robot at once"
      : "The robot does not hear this page: use its own emergency stop";
  };
  page.look = look;
  setInterval(look, 200);
}
page.stops = 0;
page.held.clear();
page.look();
