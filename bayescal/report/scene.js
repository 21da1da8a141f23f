// machines in space: turned by mouse, touch and keyboard
(() => {
const NS = "http://www.w3.org/2000/svg", HEIGHT = 230, MARGIN = 34, LARGEST = 5;
const draw = (tag, attributes, text) => {
  const one = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
  if (text !== undefined) one.textContent = text;
  return one;
};
const html = (tag, properties, ...children) => {
  const one = Object.assign(document.createElement(tag), properties);
  one.append(...children);
  return one;
};
const list = (triple) => triple.map((x) => Number(x.toPrecision(4)).toString().replace("-", "−")).join(", ");
const short = (x) => Number(x.toPrecision(2)).toLocaleString("en");

for (const svg of document.querySelectorAll("svg[data-scene]")) {
  const scene = JSON.parse(svg.dataset.scene);
  const state = { pose: 0, zoom: 1, azimuth: scene.azimuth, elevation: scene.elevation, magnified: scene.magnified };
  const everywhere = scene.points.flatMap((point) => point.at);
  const middle = [0, 1, 2].map((k) => {
    const values = everywhere.map((at) => at[k]);
    return (Math.min(...values) + Math.max(...values)) / 2;
  });
  const size = Math.max(...everywhere.map((at) => Math.hypot(...at.map((x, k) => x - middle[k])))) || 1;
  const at = (point) => point.at[Math.min(state.pose, point.at.length - 1)];

  function project(place) {
    const scale = state.zoom * (HEIGHT - MARGIN) / size, a = state.azimuth * Math.PI / 180, e = state.elevation * Math.PI / 180;
    const [x, y, z] = place.map((one, k) => scale * (one - middle[k]));
    const away = x * Math.sin(a) + y * Math.cos(a);
    return [x * Math.cos(a) - y * Math.sin(a), -(z * Math.cos(e) + away * Math.sin(e)), away * Math.cos(e) - z * Math.sin(e)];
  }
  const path = (places, closed) => `M${places.map((one) => `${one[0].toFixed(1)} ${one[1].toFixed(1)}`).join("L")}${closed ? "Z" : ""}`;

  function render() {
    const parts = [];  // [depth, element], the farthest first
    const places = scene.points.map((point) => project(at(point)));
    for (const line of scene.lines) {
      const mine = line.points.map((k) => places[k]);
      const depth = mine.reduce((sum, one) => sum + one[2], 0) / mine.length;
      parts.push([depth, draw("path", { class: line.group, d: path(mine, line.closed) })]);
    }
    scene.points.forEach((point, k) => {
      const here = at(point), [x, y, depth] = places[k], by = state.magnified;
      if (by && point.offset) {
        const end = project(here.map((one, axis) => one + by * point.offset[axis]));
        parts.push([depth, draw("path", { class: "moved", d: path([[x, y], end]) })]);
        parts.push([depth, draw("circle", { class: "moved", cx: end[0].toFixed(1), cy: end[1].toFixed(1), r: 2.6 })]);
      }
      if (by && point.spread) point.spread.forEach((sd, axis) => {
        const ends = [-1, 1].map((sign) => project(here.map((one, j) => one + (j === axis ? sign * by * sd : 0))));
        parts.push([depth, draw("path", { class: "spread", d: path(ends) })]);
      });
      const circle = draw("circle", { class: `${point.group} tip`, cx: x.toFixed(1), cy: y.toFixed(1), r: 3.4 });
      let text = `${point.name}: ${list(here)} mm`;
      if (point.offset) text += `; found ${list(point.offset)} mm from there`;
      if (point.spread) text += `; known to ${list(point.spread)} mm`;
      circle.append(draw("title", {}, text));
      parts.push([depth - 1, circle]);
    });
    parts.sort((one, other) => other[0] - one[0]);
    const front = [];
    for (const [text, members] of scene.labels) {
      const [x, y] = [0, 1].map((axis) => members.reduce((sum, k) => sum + places[k][axis], 0) / members.length);
      front.push(draw("text", { x: (x + 7).toFixed(1), y: (y - 7).toFixed(1) }, text));
    }
    const corner = [-285, 195];
    ["x", "y", "z"].forEach((name, axis) => {
      const zoom = state.zoom;
      state.zoom = 1;
      const end = project(middle.map((one, k) => one + (k === axis ? 32 * size / (HEIGHT - MARGIN) : 0)));
      state.zoom = zoom;
      front.push(draw("path", { class: "axis", d: path([corner, [corner[0] + end[0], corner[1] + end[1]]]) }));
      front.push(draw("text", { x: (corner[0] + 1.25 * end[0] - 4).toFixed(1), y: (corner[1] + 1.25 * end[1] + 4).toFixed(1) }, name));
    });
    svg.replaceChildren(...parts.map((one) => one[1]), ...front);
  }

  function turn(across, upwards) {
    state.azimuth += across;
    state.elevation = Math.max(-90, Math.min(90, state.elevation + upwards));
    render();
  }
  const zoom = (by) => { state.zoom = Math.max(0.5, Math.min(8, state.zoom * by)); render(); };
  const reset = () => { Object.assign(state, { zoom: 1, azimuth: scene.azimuth, elevation: scene.elevation }); render(); };
  const keys = {
    ArrowLeft: () => turn(-6, 0), ArrowRight: () => turn(6, 0), ArrowUp: () => turn(0, 6), ArrowDown: () => turn(0, -6),
    "+": () => zoom(1.2), "-": () => zoom(1 / 1.2), Home: reset,
  };
  svg.tabIndex = 0;
  svg.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  const fingers = new Map();
  svg.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], other = [...fingers.entries()].find(([id]) => id !== event.pointerId)?.[1];
    fingers.set(event.pointerId, now);
    if (other) return zoom(Math.hypot(now[0] - other[0], now[1] - other[1]) / (Math.hypot(before[0] - other[0], before[1] - other[1]) || 1));
    turn((now[0] - before[0]) * 0.5, (now[1] - before[1]) * 0.5);
  });
  for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, (event) => fingers.delete(event.pointerId));

  const controls = html("div", { className: "controls" });
  if (scene.poses.length > 1) {
    const select = html("select", {}, ...scene.poses.map((name, k) => html("option", { value: k }, name)));
    select.addEventListener("change", () => { state.pose = Number(select.value); render(); });
    controls.append(html("label", {}, "Pose", select));
  }
  if (scene.magnified) {
    const output = html("output", {}, `${short(state.magnified)} ×`);
    const slider = html("input", { type: "range", min: -2, max: 1.5, step: 0.1, value: 0 });
    slider.addEventListener("input", () => {
      state.magnified = slider.value <= -2 ? 0 : scene.magnified * LARGEST ** Number(slider.value);
      output.textContent = `${short(state.magnified)} ×`;
      render();
    });
    controls.append(html("label", {}, "Magnified", slider, output));
  }
  for (const [text, title, act] of [["+", "Larger", () => zoom(1.2)], ["−", "Smaller", () => zoom(1 / 1.2)], ["Reset", "As at first", reset]]) {
    const button = html("button", { type: "button", title }, text);
    button.addEventListener("click", act);
    controls.append(button);
  }
  controls.append("Turn: drag, or arrow keys");
  svg.after(controls);
  render();
}
})();
