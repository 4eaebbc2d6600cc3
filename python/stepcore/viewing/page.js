// Replays runs of stepcore with three.js, which stands before this script in the page.
"use strict";
(async () => {
  const byId = (id) => document.getElementById(id);
  const fail = (text) => {
    byId("failed").textContent = text;
    byId("failed").hidden = false;
  };

  // The data: JSON, deflated, in base64; arrays in it are base64 again.
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const floats = (text) => new Float32Array(bytes(text).buffer);
  if (typeof DecompressionStream === "undefined") {
    fail("This browser is too old for this page: it needs DecompressionStream.");
    return;
  }
  const packed = new Blob([bytes(byId("data").textContent)]).stream();
  const inflated = packed.pipeThrough(new DecompressionStream("deflate"));
  const data = JSON.parse(await new Response(inflated).text());

  let renderer;
  const screen = byId("scene");
  try {
    renderer = new THREE.WebGLRenderer({
      canvas: screen, antialias: true, preserveDrawingBuffer: true,
    });
  } catch {
    fail("This browser shows no WebGL, with which this page draws.");
    return;
  }
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(dark ? 0x23272e : 0xe9eef4);
  // A sky, and a sun behind the camera.
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8d8d99, 0.75));
  const sun = new THREE.DirectionalLight(0xffffff, 0.55);
  scene.add(sun, sun.target);
  const extent = data.extent;
  const camera = new THREE.PerspectiveCamera(40, 1, extent / 200, extent * 200);
  camera.up.set(0, 0, 1);

  const { meshOf, stretch, surfaceOf, tendon } = shapeMakers(renderer, data, bytes);
  const extras = [];

  function build(run, number) {
    const drawing = run.drawing;
    const surfaces = drawing.surfaces.map(surfaceOf);
    run.bodies = drawing.bodies.map(() => new THREE.Group());
    for (const body of run.bodies) scene.add(body);
    for (const shape of drawing.shapes) {
      // The ground is drawn once.
      if (number > 0 && !drawing.moving[shape.body]) continue;
      const mesh = meshOf(shape, run, surfaces);
      if (!shape.shown) extras.push(mesh);
      run.bodies[shape.body].add(mesh);
    }
    for (const name of ["time", "poses", "contacts", "energy", "residual"]) {
      run[name] = floats(run[name]);
    }
    run.starts = new Uint32Array(bytes(run.starts).buffer);
    run.tendons = run.tendons.map((ways) => tendon(floats(ways), run.time.length));
    for (const { rods } of run.tendons) scene.add(...rods);
    run.marks = [];
  }
  data.runs.forEach(build);
  const runs = data.runs;
  const gaps = (data.distance || []).map(floats);

  // Lines between the bodies of the first run and those of the others.
  const links = runs.slice(1).map(() => {
    const line = new THREE.LineSegments(
      new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: data.colours.link }),
    );
    line.frustumCulled = false;
    scene.add(line);
    return line;
  });

  // Contacts: a point, and an arrow as long as the force is large.
  const dot = new THREE.SphereGeometry(0.008 * extent, 12, 8);
  const shaft = new THREE.CylinderGeometry(1, 1, 1, 10).translate(0, 0.5, 0);
  const tip = new THREE.ConeGeometry(1, 1, 14).translate(0, 0.5, 0);
  const amber = new THREE.MeshBasicMaterial({ color: data.colours.contact, depthTest: false });
  const red = new THREE.MeshBasicMaterial({ color: data.colours.force, depthTest: false });
  const up = new THREE.Vector3(0, 1, 0);

  function mark(run, k) {
    if (!run.marks[k]) {
      const group = new THREE.Group();
      const point = new THREE.Mesh(dot, amber);
      const arrow = new THREE.Group();
      arrow.add(new THREE.Mesh(shaft, red), new THREE.Mesh(tip, red));
      for (const part of [point, ...arrow.children]) part.renderOrder = 2;
      group.add(arrow, point);
      scene.add(group);
      run.marks[k] = { group, point, arrow };
    }
    return run.marks[k];
  }

  function showContacts(run, frame) {
    const first = run.starts[frame];
    const count = run.starts[frame + 1] - first;
    for (let k = 0; k < Math.max(count, run.marks.length); k++) {
      const made = mark(run, k);
      made.group.visible = k < count;
      if (k >= count) continue;
      const at = 6 * (first + k);
      made.group.position.set(...run.contacts.subarray(at, at + 3));
      const force = new THREE.Vector3(...run.contacts.subarray(at + 3, at + 6));
      const length = (force.length() / data.newtons) * data.arrow;
      made.point.visible = byId("contacts").checked;
      made.arrow.visible = byId("forces").checked && length > 0.004 * extent;
      made.arrow.quaternion.setFromUnitVectors(up, force.normalize());
      const thick = 0.006 * extent;
      const head = Math.min(0.5 * length, 5 * thick);
      made.arrow.children[0].scale.set(thick, length - head, thick);
      made.arrow.children[1].position.set(0, length - head, 0);
      made.arrow.children[1].scale.set(2.2 * thick, head, 2.2 * thick);
    }
  }

  // Time.

  const end = Math.max(...runs.map((run) => run.time[run.time.length - 1]));
  const begin = Math.min(...runs.map((run) => run.time[0]));
  let now = begin;
  const sheet = figureSheet(runs, gaps, data.colours, { begin, end }, byId);
  let playing = true;

  function frameAt(run, time) {
    let low = 0;
    let high = run.time.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (run.time[middle] <= time) low = middle;
      else high = middle;
    }
    if (high === 0) return { frame: 0, next: 0, share: 0 };
    const span = run.time[high] - run.time[low];
    const share = Math.min(1, Math.max(0, (time - run.time[low]) / (span || 1)));
    return share >= 1 ? { frame: high, next: high, share: 0 } : { frame: low, next: high, share };
  }

  const here = new THREE.Vector3();
  const turn = new THREE.Quaternion();
  function pose(run, { frame, next, share }) {
    const count = run.bodies.length;
    run.bodies.forEach((body, b) => {
      const a = 7 * (frame * count + b);
      const z = 7 * (next * count + b);
      const p = run.poses;
      body.position.set(p[a], p[a + 1], p[a + 2]);
      body.position.lerp(here.set(p[z], p[z + 1], p[z + 2]), share);
      body.quaternion.set(p[a + 4], p[a + 5], p[a + 6], p[a + 3]);
      body.quaternion.slerp(turn.set(p[z + 4], p[z + 5], p[z + 6], p[z + 3]), share);
      body.updateMatrixWorld();
    });
    for (const each of run.tendons) stretch(each, { frame, next, share });
  }

  function show(time) {
    time = Math.min(end, Math.max(begin, time));
    now = time;
    const at = runs.map((run) => frameAt(run, time));
    runs.forEach((run, k) => {
      pose(run, at[k]);
      showContacts(run, at[k].frame);
    });
    links.forEach((line, k) => {
      const points = [];
      runs[0].bodies.forEach((body, b) => {
        if (!runs[0].drawing.moving[b] || !runs[k + 1].bodies[b]) return;
        points.push(body.position.clone(), runs[k + 1].bodies[b].position.clone());
      });
      line.geometry.setFromPoints(points);
    });
    byId("slider").value = (time - begin) / (end - begin || 1);
    byId("clock").textContent = `${time.toFixed(3)} of ${end.toFixed(3)} s`;
    sheet.figures(at[0].frame);
    sheet.plot(time);
  }

  // The camera goes round a point; z is up.

  const target = new THREE.Vector3();
  const view = { turn: -0.9, lift: 0.35, far: 1.7 * extent };

  function middle() {
    const box = new THREE.Box3();
    runs[0].bodies.forEach((body, b) => {
      if (!runs[0].drawing.moving[b]) return;
      body.children.forEach((mesh) => mesh.visible && box.expandByObject(mesh));
    });
    if (box.isEmpty()) box.expandByObject(scene.children.find((c) => c.isGroup) || scene);
    if (box.isEmpty()) return new THREE.Vector3();
    // A motion that stays near is seen whole: the view is as much wider as it is longer.
    const size = box.getSize(new THREE.Vector3()).length();
    const whole = box.clone();
    const { poses, bodies, drawing } = runs[0];
    for (let a = 0; a < poses.length; a += 7) {
      if (drawing.moving[(a / 7) % bodies.length]) {
        whole.expandByPoint(here.set(poses[a], poses[a + 1], poses[a + 2]));
      }
    }
    const wider = whole.getSize(new THREE.Vector3()).length() / (size || 1);
    if (wider > 3) return box.getCenter(new THREE.Vector3());
    view.far *= wider;
    return whole.getCenter(new THREE.Vector3());
  }

  function place() {
    const flat = view.far * Math.cos(view.lift);
    camera.position.set(
      target.x + flat * Math.cos(view.turn), target.y + flat * Math.sin(view.turn),
      target.z + view.far * Math.sin(view.lift),
    );
    camera.lookAt(target);
    sun.position.copy(camera.position).add(new THREE.Vector3(0, 0, 2 * extent));
    sun.target.position.copy(target);
  }

  const held = new Map();
  const spread = () => {
    const [a, b] = [...held.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  screen.addEventListener("contextmenu", (event) => event.preventDefault());
  screen.addEventListener("pointerdown", (event) => {
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    screen.setPointerCapture(event.pointerId);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    screen.addEventListener(name, (event) => held.delete(event.pointerId));
  }
  screen.addEventListener("pointermove", (event) => {
    const old = held.get(event.pointerId);
    if (!old) return;
    const before = held.size === 2 ? spread() : 0;
    const dx = event.clientX - old.x;
    const dy = event.clientY - old.y;
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (held.size === 2) {
      view.far *= before / (spread() || 1);
    } else if (event.buttons & 2 || event.shiftKey) {
      const size = view.far / screen.clientHeight;
      const side = new THREE.Vector3().setFromMatrixColumn(camera.matrix, 0);
      const top = new THREE.Vector3().setFromMatrixColumn(camera.matrix, 1);
      target.addScaledVector(side, -dx * size).addScaledVector(top, dy * size);
    } else {
      view.turn -= 0.006 * dx;
      view.lift = Math.min(1.55, Math.max(-1.55, view.lift + 0.006 * dy));
    }
    place();
  });
  screen.addEventListener("wheel", (event) => {
    event.preventDefault();
    view.far *= Math.exp(0.0012 * event.deltaY);
    place();
  }, { passive: false });

  // What can be pressed.

  function play(on) {
    playing = on;
    byId("play").textContent = on ? "pause" : "play";
  }
  function step(by) {
    play(false);
    const time = runs[0].time;
    const { frame, share } = frameAt(runs[0], now);
    const nearest = frame + Math.round(share);
    show(time[Math.min(time.length - 1, Math.max(0, nearest + by))]);
  }
  byId("play").onclick = () => {
    if (!playing && now >= end) show(begin);
    play(!playing);
  };
  byId("back").onclick = () => step(-1);
  byId("on").onclick = () => step(1);
  byId("slider").oninput = (event) => {
    play(false);
    show(begin + event.target.value * (end - begin));
  };
  byId("contacts").onchange = byId("forces").onchange = () => show(now);
  byId("all").onchange = (event) => {
    for (const mesh of extras) mesh.visible = event.target.checked;
  };
  byId("all").parentElement.hidden = !extras.length;
  document.addEventListener("keydown", (event) => {
    if (["INPUT", "SELECT", "BUTTON"].includes(event.target.tagName)) return;
    if (event.key === " ") byId("play").onclick();
    else if (event.key === "ArrowRight") step(1);
    else if (event.key === "ArrowLeft") step(-1);
    else return;
    event.preventDefault();
  });
  byId("scale").textContent =
    `The arrow of ${sheet.number(data.newtons)} N is ${sheet.number(data.arrow)} m long. ` +
    ["Drag to turn, shift-drag to move, wheel to zoom, space to pause.", ...data.notes].join(" ");
  if (runs.length > 1) {
    byId("runs").innerHTML = runs.map((run) => {
      const colour = run.tint ? sheet.cssOf(run.tint) : "#8b929c";
      return `<span><i class="key" style="background:${colour}"></i></span>`;
    }).join("");
    runs.forEach((run, k) => byId("runs").children[k].append(sheet.labelOf(k)));
  }

  function resize() {
    renderer.setPixelRatio(window.devicePixelRatio);
    const { innerWidth: width, innerHeight: height } = window;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    // A narrow window shows as much from side to side as a square one.
    camera.fov = 2 * Math.atan(0.364 / Math.min(1, width / height)) * (180 / Math.PI);
    // What is looked at stands in the middle of what panel and clock leave free.
    const covered = byId("panel").open ? document.querySelector("aside").offsetWidth : 0;
    const aside = width > 2.5 * covered ? -covered / 2 : 0;
    const under = document.querySelector("footer").offsetHeight / 2;
    camera.setViewOffset(width, height, aside, under, width, height);
  }
  // On a telephone the panel would cover what moves.
  byId("panel").open = Math.min(window.innerWidth, window.innerHeight) > 500;
  byId("panel").ontoggle = resize;
  window.addEventListener("resize", resize);
  resize();
  show(begin);
  target.copy(middle());
  place();

  // Following keeps the view as it is, and moves it with the mean of the bodies.
  function mean() {
    const moving = runs[0].bodies.filter((_, b) => runs[0].drawing.moving[b]);
    const sum = new THREE.Vector3();
    for (const body of moving) sum.add(body.position);
    return sum.divideScalar(moving.length || 1);
  }
  // A page that shows the same again need not draw it again.
  let shown = "";
  let last = performance.now();
  let followed = mean();
  function tick(clock) {
    const passed = Math.min(0.1, (clock - last) / 1000);
    last = clock;
    if (playing && end > begin) {
      const time = now + passed * byId("speed").value;
      // It waits a second at the end, and begins again.
      if (time > end + 1) show(begin);
      else if (time > end) {
        show(end);
        now = time;
      } else show(time);
    }
    const there = mean();
    if (byId("track").checked) {
      target.add(there).sub(followed);
      place();
    }
    followed = there;
    const boxes = ["contacts", "forces", "all"].map((name) => byId(name).checked);
    const { clientWidth, clientHeight } = screen;
    const eye = [...camera.position.toArray(), ...camera.quaternion.toArray()];
    const state = [now, ...eye, ...boxes, clientWidth, clientHeight].join();
    if (state !== shown) renderer.render(scene, camera);
    shown = state;
    requestAnimationFrame(tick);
  }
  requestAnimationFrame(tick);
  // For those who drive the page from outside, such as tests.
  window.replay = {
    begin, end,
    seek: (time) => {
      play(false);
      show(time);
      renderer.render(scene, camera);
    },
    place: (turnBy, lift, far) => {
      Object.assign(view, { turn: turnBy, lift, far: far * extent });
      place();
      renderer.render(scene, camera);
    },
    bodies: (run = 0) => runs[run].bodies.map((body) => body.position.toArray()),
    // Where a body stands in the window, from the left and from above, in shares of it.
    seen: (body) => {
      const { x, y } = runs[0].bodies[body].position.clone().project(camera);
      return [(1 + x) / 2, (1 - y) / 2];
    },
  };
})();
