// The 3-D view of the report. World: metres, z up. Bodies are drawn at their poses in the planner's scene. Realised
// motion is applied relative to each body's first state, because the target world has its own body frames.
(function () {
  'use strict';
  const data = JSON.parse(document.getElementById('data').textContent);
  const canvas = document.getElementById('canvas');
  const box = document.getElementById('viewer');
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const floats = (text) => new Float32Array(bytes(text).buffer);
  const indices = (text) => new Uint32Array(bytes(text).buffer);

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
  } catch (error) {
    const hint = document.getElementById('hint');
    hint.textContent = 'The 3-D view needs WebGL, which this browser does not provide: ' + error.message;
    return;
  }
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFSoftShadowMap;
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0x20242a);
  const camera = new THREE.PerspectiveCamera(45, 1, 0.01, 50);
  camera.up.set(0, 0, 1);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = true;
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8578, 1.6));
  const sun = new THREE.DirectionalLight(0xffffff, 1.8);
  sun.castShadow = true;
  sun.shadow.mapSize.set(2048, 2048);
  scene.add(sun, sun.target);

  const layers = {};
  const layer = (name, visible) => {
    const group = new THREE.Group();
    group.visible = visible;
    scene.add(group);
    layers[name] = group;
    return group;
  };

  const geometryOf = (mesh) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(floats(mesh.v), 3));
    if (mesh.c) {
      const srgb = bytes(mesh.c);
      const color = new THREE.Color();
      const linear = new Float32Array(srgb.length);
      for (let i = 0; i < srgb.length; i += 3) {
        color.setRGB(srgb[i] / 255, srgb[i + 1] / 255, srgb[i + 2] / 255, THREE.SRGBColorSpace);
        linear.set([color.r, color.g, color.b], i);
      }
      geometry.setAttribute('color', new THREE.BufferAttribute(linear, 3));
    }
    geometry.setIndex(new THREE.BufferAttribute(indices(mesh.t), 1));
    geometry.computeVertexNormals();
    return geometry;
  };
  const colorOf = (c) => new THREE.Color().setRGB(c[0] / 255, c[1] / 255, c[2] / 255, THREE.SRGBColorSpace);
  const palette = [0x4d86f0, 0xf0a84d, 0x5fc08a, 0xd96aa8, 0x9b7ce8, 0x55c5d6, 0xd9d25a, 0xe8735f];

  // Gaussians as round points, sized like their discs.
  const pointsMaterial = (colors) => new THREE.ShaderMaterial({
    uniforms: { height: { value: 600 } },
    vertexShader: `attribute float size; attribute vec3 tint; varying vec3 vTint; uniform float height;
      void main() { vTint = tint; vec4 p = modelViewMatrix * vec4(position, 1.0);
      gl_Position = projectionMatrix * p;
      gl_PointSize = clamp(2.6 * size * height * projectionMatrix[1][1] / max(-p.z, 0.01), 1.5, 40.0); }`,
    fragmentShader: `varying vec3 vTint; void main() { vec2 d = gl_PointCoord - 0.5;
      if (dot(d, d) > 0.25) discard; gl_FragColor = vec4(vTint, 1.0); }`,
  });
  const materials = [];
  const addPoints = (group, colors) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(floats(data.points.pos), 3));
    geometry.setAttribute('size', new THREE.BufferAttribute(floats(data.points.size), 1));
    geometry.setAttribute('tint', new THREE.BufferAttribute(bytes(colors), 3, true));
    const material = pointsMaterial();
    materials.push(material);
    group.add(new THREE.Points(geometry, material));
  };
  if (data.points) {
    addPoints(layer('Gaussians', false), data.points.col);
    addPoints(layer('Affinity labels', false), data.points.lab);
  }

  // Bodies.
  const meshes = layer('Meshes', true);
  const parts = layer('Convex parts', false);
  const ghosts = layer('Realised', true);
  const bounds = new THREE.Box3();
  const movers = {};
  const setPose = (object, p) => {
    object.position.set(p[0], p[1], p[2]);
    object.quaternion.set(p[3], p[4], p[5], p[6]);
  };
  let shade = 0;
  for (const body of data.bodies) {
    if (body.floor) {
      const floor = new THREE.Mesh(new THREE.PlaneGeometry(6, 6),
        new THREE.MeshStandardMaterial({ color: 0xcfc8ba, roughness: 1 }));
      floor.position.z = body.pose[2] - 0.0005;
      floor.receiveShadow = true;
      layer('Floor', true).add(floor);
      continue;
    }
    const dynamic = body.kind === 'dynamic';
    const solid = new THREE.Group();
    const hulls = new THREE.Group();
    const ghost = new THREE.Group();
    if (body.visual) {
      const geometry = geometryOf(body.visual);
      const mesh = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({
        color: body.visual.c ? 0xffffff : colorOf(body.color), vertexColors: Boolean(body.visual.c),
        roughness: 0.75, side: THREE.DoubleSide }));
      mesh.castShadow = dynamic;
      mesh.receiveShadow = true;
      solid.add(mesh);
      if (dynamic) {
        ghost.add(new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({
          color: 0x49d17c, transparent: true, opacity: 0.45, depthWrite: false })));
        geometry.computeBoundingSphere();
        bounds.expandByPoint(new THREE.Vector3(body.pose[0], body.pose[1], body.pose[2]));
      }
    }
    for (const part of body.parts) {
      const geometry = geometryOf(part);
      hulls.add(new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({
        color: palette[shade++ % palette.length], roughness: 0.8, flatShading: true, side: THREE.DoubleSide })));
    }
    for (const object of [solid, hulls, ghost]) setPose(object, body.pose);
    meshes.add(solid);
    parts.add(hulls);
    if (dynamic && data.realised) ghosts.add(ghost);
    movers[body.name] = { start: body.pose, solid, hulls, ghost };
  }

  // Goal and striker.
  if (data.goal) {
    const goal = layer('Goal', true);
    [[0, 0.015, 0xd93333], [0.015, 0.03, 0xffffff], [0.03, 0.045, 0xd93333]].forEach(([a, b, color], i) => {
      const ring = new THREE.Mesh(new THREE.RingGeometry(a, b, 48),
        new THREE.MeshBasicMaterial({ color, side: THREE.DoubleSide }));
      ring.position.set(data.goal[0], data.goal[1], 0.001 + i * 0.0002);
      goal.add(ring);
    });
    bounds.expandByPoint(new THREE.Vector3(data.goal[0], data.goal[1], 0));
  }
  const striker = (color, opacity) => {
    const h = data.striker || [0.01, 0.01, 0.03];
    const mesh = new THREE.Mesh(new THREE.BoxGeometry(2 * h[0], 2 * h[1], 2 * h[2]),
      new THREE.MeshStandardMaterial({ color, transparent: opacity < 1, opacity }));
    mesh.castShadow = opacity === 1;
    mesh.visible = false;
    return mesh;
  };

  // Motion.
  const motion = (source) => {
    if (!source) return null;
    const bodies = {};
    for (const [name, text] of Object.entries(source.bodies)) bodies[name] = floats(text);
    const times = floats(source.times);
    // The finger is removed after its sweep: show it until the first jump.
    let sweep = times.length ? times[times.length - 1] : 0;
    const arm = bodies.striker;
    for (let i = 1; arm && i < times.length; i++) {
      if (Math.hypot(...[0, 1, 2].map((k) => arm[i * 7 + k] - arm[i * 7 - 7 + k])) > 0.05) { sweep = times[i - 1]; break; }
    }
    return { times, bodies, sweep };
  };
  const predicted = motion(data.predicted);
  const realised = motion(data.realised);
  const arms = { predicted: striker(0x30343a, 1), realised: striker(0x49d17c, 0.4) };
  meshes.add(arms.predicted);
  ghosts.add(arms.realised);
  const addPath = (group, track, color) => {
    const n = track.length / 7;
    const points = new Float32Array(n * 3);
    let moved = 0;
    for (let i = 0; i < n; i++) {
      points.set(track.subarray(i * 7, i * 7 + 3), i * 3);
      moved = Math.max(moved, Math.hypot(track[i * 7] - track[0], track[i * 7 + 1] - track[1]));
    }
    if (moved < 0.003) return;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(points, 3));
    group.add(new THREE.Line(geometry, new THREE.LineBasicMaterial({ color })));
  };
  const paths = layer('Paths', true);
  if (predicted) for (const [n, t] of Object.entries(predicted.bodies)) if (n !== 'striker') addPath(paths, t, 0x4d86f0);
  if (realised) for (const [n, t] of Object.entries(realised.bodies)) if (n !== 'striker') addPath(paths, t, 0x49d17c);

  const qa = new THREE.Quaternion();
  const qb = new THREE.Quaternion();
  const va = new THREE.Vector3();
  const sample = (m, track, time, position, rotation) => {
    const times = m.times;
    let i = 0;
    let high = times.length - 1;
    while (i < high) { const mid = (i + high + 1) >> 1; if (times[mid] <= time) i = mid; else high = mid - 1; }
    const j = Math.min(i + 1, times.length - 1);
    const span = times[j] - times[i];
    const f = span > 0 ? Math.min(1, (time - times[i]) / span) : 0;
    position.fromArray(track, i * 7).lerp(va.fromArray(track, j * 7), f);
    rotation.fromArray(track, i * 7 + 3).slerp(qb.fromArray(track, j * 7 + 3), f);
  };
  const p0 = new THREE.Vector3();
  const q0 = new THREE.Quaternion();
  const p1 = new THREE.Vector3();
  const follow = (m, time, key, arm) => {
    if (!m) return;
    for (const [name, track] of Object.entries(m.bodies)) {
      if (name === 'striker') {
        arm.visible = true;
        sample(m, track, time, arm.position, arm.quaternion);
        arm.visible = time <= m.sweep;
        continue;
      }
      const mover = movers[name];
      if (!mover) continue;
      // Relative motion since the first state, applied to the scanned pose.
      sample(m, track, 0, p0, q0);
      sample(m, track, time, p1, qa);
      const turn = qa.clone().multiply(q0.invert());
      const start = mover.start;
      const offset = new THREE.Vector3(start[0], start[1], start[2]).sub(p0).applyQuaternion(turn);
      const rotation = turn.multiply(new THREE.Quaternion(start[3], start[4], start[5], start[6]));
      for (const object of key === 'solid' ? [mover.solid, mover.hulls] : [mover.ghost]) {
        object.position.copy(p1).add(offset);
        object.quaternion.copy(rotation);
      }
    }
  };

  // Controls.
  const panel = document.getElementById('layers');
  for (const [name, group] of Object.entries(layers)) {
    if (group.children.length === 0) continue;
    const button = document.createElement('button');
    button.textContent = name;
    button.className = group.visible ? 'on' : '';
    button.onclick = () => {
      group.visible = !group.visible;
      button.className = group.visible ? 'on' : '';
    };
    panel.append(button);
  }
  const last = (m) => (m && m.times.length ? m.times[m.times.length - 1] : 0);
  const duration = Math.max(last(predicted), last(realised));
  const slider = document.getElementById('time');
  const clock = document.getElementById('clock');
  const which = document.getElementById('which');
  const play = document.getElementById('play');
  let time = 0;
  let playing = false;
  let before = performance.now();
  const show = () => {
    const choice = which.value;
    follow(choice === 'realised' ? realised : predicted, time, 'solid', arms.predicted);
    follow(realised, time, 'ghost', arms.realised);
    // A ghost on top of its body is redundant and tints it: hide it.
    for (const mover of Object.values(movers)) {
      const apart = mover.ghost.position.distanceTo(mover.solid.position) > 0.002
        || mover.ghost.quaternion.angleTo(mover.solid.quaternion) > 0.02;
      mover.ghost.visible = choice === 'both' && apart;
    }
    if (choice !== 'both') arms.realised.visible = false;
    slider.value = duration ? String(1000 * time / duration) : '0';
    clock.textContent = time.toFixed(2) + ' s';
  };
  if (duration === 0) document.getElementById('player').style.display = 'none';
  slider.oninput = () => { time = duration * slider.value / 1000; playing = false; play.textContent = '▶'; show(); };
  which.onchange = show;
  play.onclick = () => {
    playing = !playing;
    if (playing && time >= duration) time = 0;
    play.textContent = playing ? '❚❚' : '▶';
  };
  canvas.ondblclick = (event) => {
    const rect = canvas.getBoundingClientRect();
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2(
      (event.clientX - rect.left) / rect.width * 2 - 1, 1 - (event.clientY - rect.top) / rect.height * 2), camera);
    const o = ray.ray.origin;
    const d = ray.ray.direction;
    if (d.z >= 0) return;
    const s = -o.z / d.z;
    document.getElementById('hint').textContent =
      `goal_w = [${(o.x + s * d.x).toFixed(3)}, ${(o.y + s * d.y).toFixed(3)}]`;
  };

  // Start: look at everything that moves.
  if (bounds.isEmpty() && data.points) {
    const p = floats(data.points.pos);
    for (let i = 0; i < p.length; i += 30) bounds.expandByPoint(new THREE.Vector3(p[i], p[i + 1], p[i + 2]));
    layers.Gaussians.visible = true;
  }
  const middle = bounds.isEmpty() ? new THREE.Vector3() : bounds.getCenter(new THREE.Vector3());
  const reach = Math.max(0.35, bounds.isEmpty() ? 1 : bounds.getSize(new THREE.Vector3()).length());
  controls.target.copy(middle);
  camera.position.set(middle.x - 0.8 * reach, middle.y - 0.35 * reach, middle.z + 0.5 * reach);
  sun.position.set(middle.x - 0.6, middle.y + 0.5, 1.6);
  sun.target.position.copy(middle);
  Object.assign(sun.shadow.camera, { left: -1.2, right: 1.2, top: 1.2, bottom: -1.2, near: 0.1, far: 5 });
  sun.shadow.bias = -0.0005;
  const resize = () => {
    const { clientWidth: w, clientHeight: h } = box;
    renderer.setSize(w, h, false);
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    for (const m of materials) m.uniforms.height.value = h * renderer.getPixelRatio();
  };
  new ResizeObserver(resize).observe(box);
  resize();
  const fragment = new URLSearchParams(location.hash.slice(1));
  if (fragment.has('t')) time = Math.min(duration, Number(fragment.get('t')));
  show();
  const frame = (now) => {
    const dt = (now - before) / 1000;
    before = now;
    if (playing) {
      time += dt;
      if (time >= duration) { time = duration; playing = false; play.textContent = '▶'; }
      show();
    }
    controls.update();
    renderer.render(scene, camera);
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
})();
