// Gaussians are drawn as blended splats: sorted from back to front, premultiplied, as large as their covariance appears.
SMS.makeSplats = function (source, bytes) {
  'use strict';
  const count = source.count;
  const steps = new Uint16Array(bytes(source.pos).buffer);
  const rest = bytes(source.rest);
  const centers = new Float32Array(3 * count);
  // Each Gaussian has four texels: centre and opacity; two of the covariance and the colour of its label; its colour.
  const width = 1024;
  const height = Math.ceil(4 * count / width);
  const texels = new Float32Array(4 * width * height);
  const [thin, wide] = source.log_scale;
  const pack = (r, g, b) => r * 65536 + g * 256 + b;
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < 3; k++) {
      centers[3 * i + k] = source.low[k] + steps[3 * i + k] / 65535 * (source.high[k] - source.low[k]);
    }
    const b = rest.subarray(12 * i, 12 * i + 12);
    const q = [0, 1, 2, 3].map((k) => (b[k] << 24 >> 24) / 127);
    const norm = Math.hypot(...q) || 1;
    const [x, y, z, w] = q.map((v) => v / norm);
    const s = [4, 5, 6].map((k) => Math.exp(thin + b[k] / 255 * (wide - thin)));
    const r = [
      1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
    const covariance = (a, c) => [0, 1, 2].reduce((sum, k) => sum + r[3 * a + k] * r[3 * c + k] * s[k] * s[k], 0);
    texels.set([
      centers[3 * i], centers[3 * i + 1], centers[3 * i + 2], b[7] / 255,
      covariance(0, 0), covariance(0, 1), covariance(0, 2), covariance(1, 1),
      covariance(1, 2), covariance(2, 2), pack(...source.palette[b[11]]), pack(b[8], b[9], b[10]),
      0, 0, 0, 0], 16 * i);
  }
  const texture = new THREE.DataTexture(texels, width, height, THREE.RGBAFormat, THREE.FloatType);
  texture.needsUpdate = true;

  const geometry = new THREE.InstancedBufferGeometry();
  geometry.setAttribute('position', new THREE.BufferAttribute(new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]), 3));
  geometry.setIndex(new THREE.BufferAttribute(new Uint16Array([0, 1, 2, 0, 2, 3]), 1));
  const order = new THREE.InstancedBufferAttribute(new Float32Array(count), 1);
  geometry.setAttribute('order', order);
  geometry.instanceCount = count;
  const uniforms = { data: { value: texture }, view: { value: new THREE.Vector2(1, 1) }, labels: { value: 0 } };
  const material = new THREE.ShaderMaterial({
    uniforms, transparent: true, depthWrite: false, blending: THREE.CustomBlending,
    blendSrc: THREE.OneFactor, blendDst: THREE.OneMinusSrcAlphaFactor,
    vertexShader: `precision highp float;
      uniform highp sampler2D data; uniform vec2 view; uniform float labels;
      attribute float order; varying vec2 vAt; varying vec4 vColor;
      vec3 unpack(float c) { return vec3(floor(c / 65536.0), mod(floor(c / 256.0), 256.0), mod(c, 256.0)) / 255.0; }
      void main() {
        int first = 4 * int(order + 0.5);
        ivec2 at = ivec2(first % ${width}, first / ${width});
        vec4 a = texelFetch(data, at, 0);
        vec4 b = texelFetch(data, at + ivec2(1, 0), 0);
        vec4 c = texelFetch(data, at + ivec2(2, 0), 0);
        vec4 p = modelViewMatrix * vec4(a.xyz, 1.0);
        vec4 clip = projectionMatrix * p;
        gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
        if (p.z > -0.02 || abs(clip.x) > 1.3 * clip.w || abs(clip.y) > 1.3 * clip.w) return;
        // The perspective is linear around the centre: f is in pixels per metre.
        vec2 f = 0.5 * view * vec2(projectionMatrix[0][0], projectionMatrix[1][1]);
        mat3 j = mat3(-f.x / p.z, 0.0, 0.0, 0.0, -f.y / p.z, 0.0, f.x * p.x / (p.z * p.z), f.y * p.y / (p.z * p.z), 0.0);
        mat3 t = j * mat3(modelViewMatrix);
        mat3 s = t * mat3(b.x, b.y, b.z, b.y, b.w, c.x, b.z, c.x, c.y) * transpose(t);
        // A third of a pixel is added against aliasing.
        float xx = s[0][0] + 0.3, yy = s[1][1] + 0.3, xy = s[0][1];
        float middle = 0.5 * (xx + yy);
        float reach = length(vec2(0.5 * (xx - yy), xy));
        vec2 axis = abs(xy) > 1e-6 ? normalize(vec2(xy, middle + reach - xx)) : (xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
        // Larger splats are too near for the linear perspective.
        vec2 sigma = min(sqrt(vec2(middle + reach, max(middle - reach, 0.1))), vec2(0.06 * max(view.x, view.y)));
        vAt = 3.0 * position.xy;
        vec2 offset = vAt.x * sigma.x * axis + vAt.y * sigma.y * vec2(-axis.y, axis.x);
        vColor = vec4(unpack(labels > 0.5 ? c.z : c.w), a.w);
        gl_Position = vec4(clip.xy + 2.0 * offset / view * clip.w, clip.zw);
      }`,
    fragmentShader: `precision highp float;
      varying vec2 vAt; varying vec4 vColor;
      void main() {
        float alpha = vColor.a * exp(-0.5 * dot(vAt, vAt));
        if (alpha < 0.004) discard;
        gl_FragColor = vec4(alpha * vColor.rgb, alpha);
      }`,
  });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.frustumCulled = false;

  // A counting sort with 16 bits orders the Gaussians by their distance along the viewing direction.
  const keys = new Uint32Array(count);
  const starts = new Uint32Array(65537);
  const direction = new THREE.Vector3();
  const sorted = new THREE.Vector3(0, 0, 0);
  const sort = (camera) => {
    camera.getWorldDirection(direction);
    if (direction.distanceTo(sorted) < 0.01) return;
    sorted.copy(direction);
    const depth = (i) => centers[3 * i] * direction.x + centers[3 * i + 1] * direction.y + centers[3 * i + 2] * direction.z;
    let low = Infinity;
    let high = -Infinity;
    for (let i = 0; i < count; i++) { const d = depth(i); low = Math.min(low, d); high = Math.max(high, d); }
    const scale = 65535 / Math.max(high - low, 1e-9);
    starts.fill(0);
    for (let i = 0; i < count; i++) {
      keys[i] = 65535 - Math.floor((depth(i) - low) * scale);
      starts[keys[i] + 1] += 1;
    }
    for (let k = 0; k < 65536; k++) starts[k + 1] += starts[k];
    for (let i = 0; i < count; i++) order.array[starts[keys[i]]++] = i;
    order.needsUpdate = true;
  };
  return {
    mesh,
    setLabels: (on) => { uniforms.labels.value = on ? 1 : 0; },
    prepare: (camera, size) => { sort(camera); uniforms.view.value.copy(size); },
  };
};
