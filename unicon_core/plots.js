// Draws the panels of a page by uPlot: values on hover, zoom by dragging, a double click ends it.
const css = (name) => name[0] == "-" ? getComputedStyle(document.body).getPropertyValue(name) : name;
const groups = {};
for (const box of document.querySelectorAll(".plots")) {
  const {clock, height, x, panels} = JSON.parse(box.firstElementChild.textContent);
  const group = groups[clock] ??= {plots: [], full: [Infinity, -Infinity]};
  const zoom = (min, max) => group.plots.forEach((plot) => {
    if (plot.scales.x.min != min || plot.scales.x.max != max) plot.setScale("x", {min, max});
  });
  const lines = {stroke: () => css("--line"), width: 1};
  const axis = {stroke: () => css("--text"), grid: lines, ticks: lines, labelSize: 16, labelFont: "12px sans-serif"};
  for (const panel of panels) {
    const time = x[panel.x], at = box.appendChild(document.createElement("div"));
    const said = (unit) => (plot, value) => value == null ? "–" : `${+value.toPrecision(4)} ${unit}`;
    const plot = new uPlot({
      title: panel.title, width: at.clientWidth, height,
      scales: {x: {time: false}},
      cursor: {
        sync: {key: clock, scales: ["x", null], filters: {pub: (type) => type.startsWith("mousem") || type == "mouseleave", sub: () => true}},
        bind: {dblclick: () => () => zoom(...group.full)},
      },
      axes: [{...axis, label: clock, size: 28}, {...axis, label: `[${panel.unit}]`, size: 52}],
      series: [{label: clock, value: said("")}, ...panel.curves.map((curve) => ({
        label: curve.label, stroke: () => css(curve.colour), dash: curve.dash, width: 1.2,
        points: {show: time.length < 3}, value: said(panel.unit),
      }))],
      hooks: {
        setScale: [(plot, key) => key == "x" && group.ready && zoom(plot.scales.x.min, plot.scales.x.max)],
        drawClear: [({ctx, bbox, valToPos}) => {
          ctx.fillStyle = "rgba(128, 128, 128, .16)";
          for (const ends of panel.shaded) {
            const [a, b] = ends.map((t) => Math.min(Math.max(valToPos(t, "x", true), bbox.left), bbox.left + bbox.width));
            ctx.fillRect(a, bbox.top, b - a, bbox.height);
          }
        }],
      },
    }, [time, ...panel.curves.map(({y}) => y.length == time.length ? y : time.map(() => y[0]))], at);
    group.plots.push(plot);
    group.full = [Math.min(group.full[0], time[0]), Math.max(group.full[1], time.at(-1))];
    new ResizeObserver(() => plot.setSize({width: at.clientWidth, height})).observe(at);
  }
}
for (const group of Object.values(groups)) {
  if (group.full[0] == group.full[1]) group.full = group.full.map((t, k) => t + k - 0.5);
  group.plots.forEach((plot) => plot.setScale("x", {min: group.full[0], max: group.full[1]}));
  setTimeout(() => group.ready = true);
}
matchMedia("(prefers-color-scheme: dark)").onchange = () =>
  Object.values(groups).forEach(({plots}) => plots.forEach((plot) => plot.redraw()));
