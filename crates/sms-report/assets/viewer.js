// This file draws the 3-D view of the report. The world is in metres, with z up. Bodies are drawn at their poses in the
// planner's scene. Realised motion is applied relative to each body's first state, because the target world has its own
// body frames.
(function () {
  'use strict';
  const element = (id) => document.getElementById(id);
  const data = JSON.parse(element('data').textContent);
  const canvas = element('canvas');
  const box = element('viewer');
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const floats = (text) => new Float32Array(bytes(text).buffer);
  const shorts = (text) => new Uint16Array(bytes(text).buffer);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
  } catch (error) {
    element('hint').textContent = 'The 3-D view needs WebGL, which this browser does not provide: ' + error.message;
    box.hidden = true;
    return;
  }
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const scene = new THREE.Scene();
  const background = () => { scene.background = new THREE.Color(css('--canvas')); };
  background();
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8578, 2.2));
  const sun = new THREE.DirectionalLight(0xffffff, 1.6);
  sun.position.set(-0.6, 0.5, 1.6);
  scene.add(sun);
  let needsDrawing = true;
  const changed = () => { needsDrawing = true; };
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => { background(); changed(); });

  const layers = {};
  const layer = (name, visible) => {
    if (!layers[name]) {
      layers[name] = new THREE.Group();
      layers[name].visible = visible;
      scene.add(layers[name]);
    }
    return layers[name];
  };

  const pictureOf = (address) => {
    const texture = new THREE.Texture();
    texture.colorSpace = THREE.SRGBColorSpace;
    // Charts of a baked texture are neighbours only in the image, so that smaller versions would mix them.
    texture.generateMipmaps = false;
    texture.minFilter = THREE.LinearFilter;
    const image = new Image();
    image.onload = () => { texture.image = image; texture.needsUpdate = true; changed(); };
    image.src = address;
    return texture;
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
    const indices = mesh.wide ? new Uint32Array(bytes(mesh.t).buffer) : shorts(mesh.t);
    geometry.setIndex(new THREE.BufferAttribute(indices, 1));
    geometry.computeVertexNormals();
    return geometry;
  };
  // Texture coordinates differ between the triangles of a vertex, so that the triangles share no vertices.
  const texturedOf = (geometry, mesh) => {
    const split = geometry.toNonIndexed();
    split.setAttribute('uv', new THREE.BufferAttribute(Float32Array.from(shorts(mesh.uv), (v) => v / 65535), 2));
    return split;
  };
  const colorOf = (c) => new THREE.Color().setRGB(c[0] / 255, c[1] / 255, c[2] / 255, THREE.SRGBColorSpace);
  const palette = [0x4d86f0, 0xf0a84d, 0x5fc08a, 0xd96aa8, 0x9b7ce8, 0x55c5d6, 0xd9d25a, 0xe8735f];

  // Photographs contain their light already, so that bodies with their colours are not lit again.
  const meshes = layer('Meshes', true);
  const bounds = new THREE.Box3();
  const movers = {};
  const setPose = (object, p) => {
    object.position.set(p[0], p[1], p[2]);
    object.quaternion.set(p[3], p[4], p[5], p[6]);
  };
  const addFloor = (body) => {
    const group = new THREE.Group();
    setPose(group, body.pose);
    const plain = (color, unlit) => unlit ? new THREE.MeshBasicMaterial({ color }) : new THREE.MeshStandardMaterial({ color, roughness: 1 });
    const all = new THREE.Mesh(new THREE.PlaneGeometry(6, 6), plain(data.floor ? colorOf(data.floor.mean) : 0xcfc8ba, Boolean(data.floor)));
    all.position.z = -0.001;
    group.add(all);
    if (data.floor) {
      const { low, high } = data.floor;
      const seen = new THREE.Mesh(new THREE.PlaneGeometry(high[0] - low[0], high[1] - low[1]),
        new THREE.MeshBasicMaterial({ map: pictureOf(data.floor.picture) }));
      seen.position.set((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, -0.0005);
      group.add(seen);
    }
    layer('Floor', true).add(group);
  };
  const realisedColor = new THREE.Color(css('--realised'));
  const predictedColor = new THREE.Color(css('--predicted'));
  let shade = 0;
  for (const body of data.bodies) {
    if (body.floor) { addFloor(body); continue; }
    const dynamic = body.kind === 'dynamic';
    const mover = { body, start: body.pose, solid: new THREE.Group(), hulls: new THREE.Group(), ghost: new THREE.Group(), height: 0 };
    const geometry = body.visual && geometryOf(body.visual);
    if (geometry) {
      const textured = body.picture && body.visual.uv;
      const look = { side: THREE.DoubleSide, vertexColors: Boolean(body.visual.c) };
      look.color = body.visual.c || textured ? 0xffffff : colorOf(body.color);
      if (textured) look.map = pictureOf(body.picture);
      const unlit = textured || !dynamic;
      const mesh = new THREE.Mesh(textured ? texturedOf(geometry, body.visual) : geometry,
        unlit ? new THREE.MeshBasicMaterial(look) : new THREE.MeshStandardMaterial({ ...look, roughness: 0.75 }));
      mesh.userData.name = body.name;
      mover.mark = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({
        color: body.label ? colorOf(body.label) : predictedColor, transparent: true, opacity: 0.55, depthWrite: false,
        side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -2 }));
      mover.mark.visible = false;
      mover.solid.add(mesh, mover.mark);
      mover.ghost.add(new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({
        color: realisedColor, transparent: true, opacity: 0.5, depthWrite: false })));
      geometry.computeBoundingBox();
      mover.height = geometry.boundingBox.max.z;
      if (dynamic) bounds.expandByPoint(new THREE.Vector3(body.pose[0], body.pose[1], body.pose[2]));
    }
    for (const part of body.parts) {
      mover.hulls.add(new THREE.Mesh(geometryOf(part), new THREE.MeshStandardMaterial({
        color: palette[shade++ % palette.length], roughness: 0.8, flatShading: true, side: THREE.DoubleSide })));
    }
    for (const object of [mover.solid, mover.hulls, mover.ghost]) setPose(object, body.pose);
    meshes.add(mover.solid);
    // A large scene is sent without its convex parts.
    if (body.parts.length) layer('Convex parts', false).add(mover.hulls);
    movers[body.name] = mover;
  }

  // Gaussians are hidden at first, because the meshes show the same surfaces.
  const splats = data.splats && SMS.makeSplats(data.splats, bytes);
  if (splats) layer('Gaussians', false).add(splats.mesh);

  // The goal is a target of three rings on the floor.
  if (data.goal) {
    [[0, 0.015, 0xd93333], [0.015, 0.03, 0xffffff], [0.03, 0.045, 0xd93333]].forEach(([a, b, color], i) => {
      const ring = new THREE.Mesh(new THREE.RingGeometry(a, b, 48),
        new THREE.MeshBasicMaterial({ color, side: THREE.DoubleSide }));
      ring.position.set(data.goal[0], data.goal[1], 0.001 + i * 0.0002);
      layer('Goal', true).add(ring);
    });
    bounds.expandByPoint(new THREE.Vector3(data.goal[0], data.goal[1], 0));
  }
  const striker = (color, opacity) => {
    const h = data.striker || [0.01, 0.01, 0.03];
    const mesh = new THREE.Mesh(new THREE.BoxGeometry(2 * h[0], 2 * h[1], 2 * h[2]),
      new THREE.MeshStandardMaterial({ color, transparent: opacity < 1, opacity }));
    mesh.visible = false;
    return mesh;
  };

  // A motion has the times and the poses of its bodies, seven numbers each.
  const motion = (source) => {
    if (!source) return null;
    const bodies = {};
    for (const [name, text] of Object.entries(source.bodies)) bodies[name] = floats(text);
    const times = floats(source.times);
    // The finger is removed after its sweep, so that it is shown until the first jump.
    let sweep = times.length ? times[times.length - 1] : 0;
    const arm = bodies.striker;
    for (let i = 1; arm && i < times.length; i++) {
      if (Math.hypot(...[0, 1, 2].map((k) => arm[i * 7 + k] - arm[i * 7 - 7 + k])) > 0.05) { sweep = times[i - 1]; break; }
    }
    return { times, bodies, sweep };
  };
  const predicted = motion(data.predicted);
  const realised = motion(data.realised);
  const arms = { predicted: striker(0x30343a, 1), realised: striker(realisedColor, 0.45) };
  // Without a motion, the arm is no reason for a button of the meshes.
  if (predicted) meshes.add(arms.predicted);
  if (realised) layer('Realised', true).add(arms.realised);
  // A body that rests has no path: the picture does not resolve 3 mm.
  const addPath = (name, track, color) => {
    const points = new Float32Array(track.length / 7 * 3);
    let moved = 0;
    for (let i = 0; i < track.length / 7; i++) {
      points.set(track.subarray(i * 7, i * 7 + 3), i * 3);
      moved = Math.max(moved, Math.hypot(...[0, 1, 2].map((k) => track[i * 7 + k] - track[k])));
    }
    if (moved < 0.003) return;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(points, 3));
    layer('Paths', true).add(new THREE.Line(geometry, new THREE.LineBasicMaterial({ color })));
    if (movers[name]) movers[name].moves = true;
  };
  for (const [m, color] of [[predicted, predictedColor], [realised, realisedColor]]) {
    if (m) for (const [name, track] of Object.entries(m.bodies)) if (name !== 'striker') addPath(name, track, color);
  }
  if (realised) for (const mover of Object.values(movers)) if (mover.moves) layer('Realised', true).add(mover.ghost);

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
        sample(m, track, time, arm.position, arm.quaternion);
        arm.visible = time <= m.sweep;
        continue;
      }
      const mover = movers[name];
      if (!mover) continue;
      // The motion since the first state is applied to the scanned pose.
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

  // The camera starts at the first recorded view, or looks at everything that moves.
  if (bounds.isEmpty() && data.splats) {
    bounds.set(new THREE.Vector3(...data.splats.low), new THREE.Vector3(...data.splats.high));
    // Bodies that cannot move are visible, too.
    const hasMeshes = meshes.children.length > 0;
    layers.Gaussians.visible = !hasMeshes;
    if (!hasMeshes && layers.Floor) layers.Floor.visible = false;
  }
  const middle = bounds.isEmpty() ? new THREE.Vector3() : bounds.getCenter(new THREE.Vector3());
  const reach = Math.max(0.35, bounds.isEmpty() ? 1 : bounds.getSize(new THREE.Vector3()).length());
  const view = SMS.makeCamera(canvas, box, data.views, middle, changed);
  if (data.views.length) {
    view.show(0);
  } else {
    view.controls.target.copy(middle);
    view.camera.position.set(middle.x - 0.8 * reach, middle.y - 0.35 * reach, middle.z + 0.5 * reach);
  }
  // A body that moves outside the recorded view, such as a vehicle, must be visible.
  const begin = () => {
    const tracks = [predicted, realised].flatMap((m) => (m ? Object.entries(m.bodies) : []));
    view.reveal(tracks.filter(([name]) => movers[name] && movers[name].moves).map(([, track]) => track));
  };
  const player = SMS.makePlayer({ predicted, realised, arms, movers, follow, begin, changed });
  SMS.makePanel({ canvas, box, layers, movers, splats, camera: view.camera, changed });

  const size = new THREE.Vector2();
  const resize = () => {
    renderer.setSize(box.clientWidth, box.clientHeight, false);
    view.resize();
  };
  new ResizeObserver(resize).observe(box);
  resize();
  let before = performance.now();
  const frame = (now) => {
    player.advance((now - before) / 1000);
    before = now;
    view.update();
    if (needsDrawing) {
      needsDrawing = false;
      if (splats) splats.prepare(view.camera, renderer.getDrawingBufferSize(size));
      renderer.render(scene, view.camera);
      SMS.placeNames();
    }
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
})();
