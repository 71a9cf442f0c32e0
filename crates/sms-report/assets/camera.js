// The camera of the 3-D view is free, or stands at a recorded view with the photograph over the scene.
SMS.makeCamera = function (canvas, box, views, middle, changed) {
  'use strict';
  const camera = new THREE.PerspectiveCamera(45, 1, 0.01, 50);
  camera.up.set(0, 0, 1);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = true;
  const element = (id) => document.getElementById(id);
  const overlay = element('overlay');
  const photo = overlay.querySelector('img');
  const blend = element('blend');
  let lens = null;
  let shown = -1;
  let last = 0;

  // The photograph lies in the middle of the canvas and is as large as fits.
  const rectangle = () => {
    const [w, h] = lens;
    const scale = Math.min(box.clientWidth / w, box.clientHeight / h);
    return { scale, x: (box.clientWidth - scale * w) / 2, y: (box.clientHeight - scale * h) / 2, w: scale * w, h: scale * h };
  };
  const place = () => {
    overlay.hidden = shown < 0 || !photo.src || Number(blend.value) === 0;
    if (overlay.hidden) return;
    const r = rectangle();
    Object.assign(overlay.style, {
      left: `${r.x}px`, top: `${r.y}px`, width: `${r.w * blend.value / 100}px`, height: `${r.h}px` });
    Object.assign(photo.style, { width: `${r.w}px`, height: `${r.h}px` });
  };
  // The lens of the last recorded view stays when the view is turned, so that nothing jumps.
  const resize = () => {
    const [w, h] = [box.clientWidth, box.clientHeight];
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    if (lens) {
      const [, , fx, fy, cx, cy] = lens;
      const { scale, x, y } = rectangle();
      const [near, far] = [camera.near, camera.far];
      camera.fov = 2 * Math.atan(h / (2 * scale * fy)) * 180 / Math.PI;
      camera.projectionMatrix.set(
        2 * scale * fx / w, 0, 1 - 2 * (x + scale * cx) / w, 0,
        0, 2 * scale * fy / h, 2 * (y + scale * cy) / h - 1, 0,
        0, 0, -(far + near) / (far - near), -2 * far * near / (far - near),
        0, 0, -1, 0);
      camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    }
    place();
    changed();
  };
  const flip = new THREE.Quaternion(1, 0, 0, 0);
  const show = (index) => {
    const view = views[index];
    shown = last = index;
    lens = view.lens;
    const p = view.pose;
    camera.position.set(p[0], p[1], p[2]);
    // The pose has the camera axes of OpenCV (z forward), the view those of OpenGL (z backward).
    camera.quaternion.set(p[3], p[4], p[5], p[6]).multiply(flip);
    const forward = camera.getWorldDirection(new THREE.Vector3());
    const distance = Math.max(0.1, middle.clone().sub(camera.position).dot(forward));
    controls.target.copy(camera.position).addScaledVector(forward, distance);
    const source = view.photo || (element('photo') || {}).src;
    if (source) photo.src = source;
    element('view-name').textContent = `frame ${view.frame} (${index + 1} of ${views.length})`;
    resize();
  };
  const leave = () => {
    if (shown < 0) return;
    shown = -1;
    element('view-name').textContent = 'free view';
    place();
  };
  const step = (by) => {
    if (views.length === 0) return;
    const next = shown < 0 ? last : last + by;
    show((next + views.length) % views.length);
  };
  controls.addEventListener('change', () => { leave(); changed(); });
  // This turns the camera about the target by radians, and multiplies its distance by a factor.
  const turn = (around, up, factor) => {
    leave();
    const offset = camera.position.clone().sub(controls.target);
    const radius = offset.length() * factor;
    const polar = Math.min(3.1, Math.max(0.05, Math.acos(offset.z / offset.length()) - up));
    const azimuth = Math.atan2(offset.y, offset.x) + around;
    camera.position.copy(controls.target).add(new THREE.Vector3(
      radius * Math.sin(polar) * Math.cos(azimuth), radius * Math.sin(polar) * Math.sin(azimuth), radius * Math.cos(polar)));
    controls.update();
    changed();
  };
  // Moves the camera back from a recorded view until the paths that leave it for a tenth of their poses are in the picture.
  // A pose has seven numbers. A view that the user chose stays.
  const reveal = (paths) => {
    if (shown < 0) return;
    const p = new THREE.Vector3();
    const outside = (path) => {
      let count = 0;
      for (let i = 0; i < path.length; i += 7) {
        p.fromArray(path, i).project(camera);
        if (Math.abs(p.x) > 0.95 || Math.abs(p.y) > 0.95 || Math.abs(p.z) > 1) count++;
      }
      return count;
    };
    camera.updateMatrixWorld();
    const hidden = paths.filter((path) => outside(path) > 0.1 * path.length / 7);
    for (let i = 0; i < 30 && hidden.some((path) => outside(path) > 0); i++) {
      turn(0, 0, 1.1);
      camera.updateMatrixWorld();
    }
  };
  const keys = {
    ArrowLeft: () => turn(-0.1, 0, 1), ArrowRight: () => turn(0.1, 0, 1), ArrowUp: () => turn(0, 0.1, 1),
    ArrowDown: () => turn(0, -0.1, 1), '+': () => turn(0, 0, 0.9), '=': () => turn(0, 0, 0.9), '-': () => turn(0, 0, 1.1),
    n: () => step(1), p: () => step(-1),
  };
  canvas.addEventListener('keydown', (event) => {
    const action = keys[event.key] || keys[event.key.toLowerCase()];
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    action();
  });
  blend.oninput = place;
  element('next').onclick = () => step(1);
  element('previous').onclick = () => step(-1);
  element('recorded').hidden = views.length === 0;
  return {
    camera, controls, resize, show, reveal,
    update: () => { if (shown < 0) controls.update(); },
  };
};
