// This file controls the player, the layers, the names and the highlights of the 3-D view.
'use strict';
SMS.makePlayer = function ({ predicted, realised, arms, movers, follow, begin, changed }) {
  const element = (id) => document.getElementById(id);
  const last = (m) => (m && m.times.length ? m.times[m.times.length - 1] : 0);
  const duration = Math.max(last(predicted), last(realised));
  const [slider, clock, which, play] = ['time', 'clock', 'which', 'play'].map(element);
  let time = 0;
  let playing = false;
  which.hidden = !realised;
  const show = () => {
    const choice = which.value;
    follow(choice === 'realised' ? realised : predicted, time, 'solid', arms.predicted);
    follow(realised, time, 'ghost', arms.realised);
    // A ghost on top of its body is redundant and tints it, so that it is hidden.
    for (const mover of Object.values(movers)) {
      const apart = mover.ghost.position.distanceTo(mover.solid.position) > 0.002
        || mover.ghost.quaternion.angleTo(mover.solid.quaternion) > 0.02;
      mover.ghost.visible = choice === 'both' && apart;
    }
    if (choice !== 'both') arms.realised.visible = false;
    slider.value = duration ? String(1000 * time / duration) : '0';
    slider.setAttribute('aria-valuetext', `${time.toFixed(2)} seconds`);
    clock.textContent = time.toFixed(2) + ' s';
    changed();
  };
  const setPlaying = (on) => {
    playing = on;
    play.textContent = on ? '❚❚' : '▶';
    play.setAttribute('aria-label', on ? 'pause' : 'play');
  };
  const toggle = () => {
    if (!playing && time >= duration) time = 0;
    if (!playing) begin();
    setPlaying(!playing);
  };
  element('player').hidden = duration === 0;
  slider.oninput = () => { begin(); time = duration * slider.value / 1000; setPlaying(false); show(); };
  which.onchange = show;
  play.onclick = toggle;
  element('canvas').addEventListener('keydown', (event) => {
    if (event.key !== ' ' || duration === 0) return;
    event.preventDefault();
    toggle();
  });
  const fragment = new URLSearchParams(location.hash.slice(1));
  if (fragment.has('t')) time = Math.min(duration, Number(fragment.get('t')) || 0);
  show();
  return {
    advance: (seconds) => {
      if (!playing) return;
      time = Math.min(duration, time + seconds);
      if (time >= duration) setPlaying(false);
      show();
    },
  };
};

SMS.makePanel = function ({ canvas, box, layers, movers, splats, camera, changed }) {
  const element = (id) => document.getElementById(id);
  const panel = element('layers');
  const names = element('names');
  const tip = element('tip');
  const buttons = {};
  const addButton = (name, isOn, set) => {
    const button = document.createElement('button');
    button.type = 'button';
    button.textContent = name;
    const show = () => button.setAttribute('aria-pressed', String(isOn()));
    button.onclick = () => { set(!isOn()); for (const refresh of Object.values(buttons)) refresh(); changed(); };
    buttons[name] = show;
    show();
    panel.append(button);
  };
  // Gaussians and meshes show the same surfaces, so that one hides the other.
  const solid = ['Meshes', 'Floor', 'Convex parts'];
  for (const [name, group] of Object.entries(layers)) {
    if (group.children.length === 0) continue;
    addButton(name, () => group.visible, (on) => {
      group.visible = on;
      if (on && name === 'Gaussians') for (const other of solid) if (layers[other]) layers[other].visible = false;
      if (on && solid.includes(name) && layers.Gaussians) layers.Gaussians.visible = false;
      if (on && name === 'Convex parts' && layers.Meshes) layers.Meshes.visible = false;
      if (on && name === 'Meshes' && layers['Convex parts']) layers['Convex parts'].visible = false;
      if (!on && name === 'Gaussians') for (const other of ['Meshes', 'Floor']) if (layers[other]) layers[other].visible = true;
    });
  }
  if (splats) {
    let labels = false;
    addButton('Labels', () => labels && layers.Gaussians.visible, (on) => {
      labels = on;
      splats.setLabels(on);
      layers.Gaussians.visible = true;
      for (const other of solid) if (layers[other]) layers[other].visible = false;
    });
  }

  // Each object has its name above it.
  const tags = Object.values(movers).filter((m) => m.body.label || m.body.kind === 'dynamic').map((mover) => {
    const tag = document.createElement('span');
    tag.textContent = mover.body.name;
    tag.dataset.body = mover.body.name;
    names.append(tag);
    return { tag, mover };
  });
  names.hidden = true;
  if (tags.length) addButton('Names', () => !names.hidden, (on) => { names.hidden = !on; });
  const p = new THREE.Vector3();
  SMS.placeNames = () => {
    if (names.hidden) return;
    for (const { tag, mover } of tags) {
      p.copy(mover.solid.position);
      p.z += mover.height;
      p.project(camera);
      tag.hidden = p.z > 1 || Math.abs(p.x) > 1 || Math.abs(p.y) > 1;
      if (tag.hidden) continue;
      const half = tag.offsetWidth / 2;
      const x = Math.min(box.clientWidth - half, Math.max(half, (p.x + 1) / 2 * box.clientWidth));
      const y = Math.max(tag.offsetHeight, (1 - p.y) / 2 * box.clientHeight);
      tag.style.transform = `translate(${x - half}px, ${y - tag.offsetHeight}px)`;
    }
  };

  // The pointer names and highlights the body under it.
  const ray = new THREE.Raycaster();
  const at = new THREE.Vector2();
  const aim = (event) => {
    const r = canvas.getBoundingClientRect();
    at.set((event.clientX - r.left) / r.width * 2 - 1, 1 - (event.clientY - r.top) / r.height * 2);
    ray.setFromCamera(at, camera);
  };
  let waiting = null;
  const point = () => {
    const event = waiting;
    waiting = null;
    if (!event) return;
    aim(event);
    const solids = Object.values(movers).map((m) => m.solid.children[0]).filter(Boolean);
    const hit = ray.intersectObjects(solids, false)[0];
    const name = hit ? hit.object.userData.name : null;
    SMS.highlight(name);
    tip.hidden = !name;
    if (!name) return;
    const role = movers[name].body.role;
    tip.textContent = role ? `${name} (${role})` : name;
    const r = box.getBoundingClientRect();
    const x = Math.min(event.clientX - r.left + 14, r.width - tip.offsetWidth - 4);
    tip.style.transform = `translate(${x}px, ${Math.min(event.clientY - r.top + 14, r.height - tip.offsetHeight - 4)}px)`;
  };
  const watch = (event) => {
    if (event.buttons) { tip.hidden = true; return; }
    if (!waiting) requestAnimationFrame(point);
    waiting = event;
  };
  canvas.addEventListener('pointermove', watch);
  // A tap on a touch screen names the object.
  canvas.addEventListener('click', watch);
  canvas.addEventListener('pointerleave', () => { waiting = null; tip.hidden = true; SMS.highlight(null); });
  SMS.onHighlight((name) => {
    for (const mover of Object.values(movers)) if (mover.mark) mover.mark.visible = mover.body.name === name;
    changed();
  });
  canvas.ondblclick = (event) => {
    aim(event);
    const { origin, direction } = ray.ray;
    if (direction.z >= 0) return;
    const s = -origin.z / direction.z;
    const [x, y] = [origin.x + s * direction.x, origin.y + s * direction.y].map((v) => v.toFixed(3));
    element('hint').textContent = `goal_w = [${x}, ${y}]`;
  };
};
