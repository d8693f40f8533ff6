// Pointer, wheel, keys, buttons and playback.

function handle(model) {
  const {scene, graph, source, state, redraw, about} = model, end = about.duration, over = element("over"), chart = element("graph");
  const pointers = new Map(), moving = () => scene.moving(redraw, () => pointers.size > 0);
  if (scene.pace > 1) moving();
  let moved = 0, far = 0;
  const local = (event, canvas) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  over.addEventListener("pointerdown", event => {
    over.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, local(event, over));
    moved = far = 0;
  });
  over.addEventListener("pointermove", event => {
    const here = local(event, over), before = pointers.get(event.pointerId);
    if (!before) {
      const t = scene.pick(...here, NEAR);
      if (t === null && state.hover === null) return;
      state.hover = t;
      model.tip(t, ...here);
      redraw();
      return;
    }
    const [dx, dy] = [here[0] - before[0], here[1] - before[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    pointers.set(event.pointerId, here);
    state.hover = null;
    model.tip(null);
    if (pointers.size === 2) {
      const [a, b] = [...pointers.values()], apart = Math.hypot(a[0] - b[0], a[1] - b[1]);
      scene.move(dx / 2, dy / 2);
      if (far) scene.zoom(apart / far, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
      far = apart;
    } else if (event.shiftKey || event.buttons & 6) scene.move(dx, dy);
    else if (moved > 3) scene.rotate(dx, dy);
    moving();
  });
  const lift = event => {
    if (!pointers.delete(event.pointerId) || event.type !== "pointerup" || moved > 3 || event.button) return;
    const t = scene.pick(...local(event, over), NEAR);
    if (t !== null) model.chooseTime(t);
  };
  over.addEventListener("pointerup", lift);
  over.addEventListener("pointercancel", lift);
  over.addEventListener("pointerleave", () => {
    state.hover = null;
    model.tip(null);
    redraw();
  });
  over.addEventListener("contextmenu", event => event.preventDefault());
  over.addEventListener("dblclick", () => { scene.fit(); redraw(); });
  over.addEventListener("wheel", event => {
    event.preventDefault();
    scene.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.0015)), ...local(event, over));
    moving();
  }, {passive: false});

  let pressed = null;
  chart.addEventListener("pointerdown", event => {
    chart.setPointerCapture(event.pointerId);
    pressed = {x: local(event, chart)[0], range: [...graph.range], moved: false};
  });
  chart.addEventListener("pointermove", event => {
    const [x, y] = local(event, chart);
    if (pressed) {
      pressed.moved ||= Math.abs(x - pressed.x) > 3;
      const shift = (x - pressed.x) / graph.width * (pressed.range[1] - pressed.range[0]);
      if (pressed.moved) graph.show(pressed.range[0] - shift, pressed.range[1] - shift);
    } else {
      state.hover = graph.time(x);
      model.tip(state.hover, x, element("scene").clientHeight + y - 80);
    }
    redraw();
  });
  chart.addEventListener("pointerup", event => {
    if (pressed && !pressed.moved) model.chooseTime(graph.time(local(event, chart)[0]));
    pressed = null;
  });
  chart.addEventListener("pointercancel", () => { pressed = null; });
  chart.addEventListener("pointerleave", () => {
    state.hover = null;
    model.tip(null);
    redraw();
  });
  chart.addEventListener("dblclick", () => { graph.show(0, end); redraw(); });
  chart.addEventListener("wheel", event => {
    event.preventDefault();
    graph.zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : 0.002)), local(event, chart)[0]);
    redraw();
  }, {passive: false});

  for (const button of document.querySelectorAll(".choice button")) button.addEventListener("click", () => model.press(button.dataset));
  element("files").addEventListener("change", () => { source.open(Number(element("files").value)); redraw(); });

  element("joint").addEventListener("change", () => { graph.choose(Number(element("joint").value)); redraw(); });

  let last = 0;
  function tick(now) {
    if (!state.playing) return;
    state.at = Math.min(state.at + (now - last) / 1000 * Number(element("speed").value), end);
    last = now;
    if (state.at >= end) play(false);
    moving();
    requestAnimationFrame(tick);
  }
  function play(on) {
    state.playing = on;
    element("play").textContent = on ? "pause" : "play";
    if (!on) return;
    scene.choose(null);
    state.trail = true;
    if (state.at === null || state.at >= end) state.at = 0;
    last = performance.now();
    requestAnimationFrame(tick);
  }
  element("play").addEventListener("click", () => { play(!state.playing); redraw(); });
  element("stop").addEventListener("click", () => {
    play(false);
    scene.choose(null);
    source.chosen = null;
    state.at = null;
    state.trail = false;
    element("slider").value = 0;
    source.draw();
    redraw();
  });
  element("slider").addEventListener("input", () => {
    state.at = element("slider").value / 10000 * end;
    state.trail = true;
    moving();
  });
  document.addEventListener("keydown", event => {
    if (event.target.closest("button, select, input, #source-list")) return;
    if (event.key === " ") {
      event.preventDefault();
      play(!state.playing);
      redraw();
    }
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", event => { state.dark = event.matches; redraw(); });
  new ResizeObserver(() => { source.layout(); source.scroll(source.top); redraw(); }).observe(element("source-list"));
  new ResizeObserver(() => redraw()).observe(over);
}

/** Resolves to the model of the page when it is drawn; tests and benchmarks use it. */
const opened = main();
opened.catch(error => {
  document.getElementById("trouble").hidden = false;
  document.getElementById("trouble").textContent = "This page could not be drawn: " + error.message;
  document.documentElement.dataset.failed = error.message;
});
