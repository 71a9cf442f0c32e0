//! Densities and accelerations: sums over neighbours, eight at a time.

use super::cells::CellGrid;
use super::kernel::KernelShape;
use super::lanes::{PortableLanes, SphLanes, WIDTH};
use super::particles::Particles;
use rayon::prelude::*;

/// Number of particles per task.
const CHUNK: usize = 96;

/// Parameters of the equation of motion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gas {
    /// Radius of the kernel's support, metres.
    pub(super) support: f32,
    /// Mass of a particle, kg.
    pub(super) mass: f32,
    /// Density above which the pressure is positive, kg/m³.
    pub(super) rest_density: f32,
    /// Sound speed, m/s.
    pub(super) sound_speed: f32,
    /// Exponent γ of the equation of state.
    pub(super) exponent: f32,
    /// Monaghan's α.
    pub(super) viscosity: f32,
}

impl Gas {
    /// p = c²ρ₀/γ·((ρ/ρ₀)^γ − 1), clamped at zero.
    fn pressure(&self, density: f32) -> f32 {
        let ratio = density / self.rest_density;
        let stretch = if self.exponent == 1.0 { ratio } else { ratio.powf(self.exponent) };
        (self.sound_speed * self.sound_speed * self.rest_density / self.exponent * (stretch - 1.0)).max(0.0)
    }
}

/// Computes density and acceleration of all particles, which must be sorted into `cells`.
pub(super) fn accelerations<K: KernelShape>(gas: &Gas, p: &mut Particles, cells: &CellGrid, parallel: bool) {
    let n = p.len();
    let (x, v, density, pressure, acceleration) =
        (&p.x, &p.v, &mut p.density, &mut p.pressure, &mut p.acceleration);
    density.resize(n + WIDTH, 1.0);
    density[n..].fill(1.0);
    each_chunk(&mut density[..n], CHUNK, parallel, |first, out| densities::<K>(gas, x, cells, first, out));
    pressure.resize(n + WIDTH, 0.0);
    pressure[n..].fill(0.0);
    for i in 0..n {
        pressure[i] = gas.pressure(density[i]) / (density[i] * density[i]);
    }
    let (density, pressure) = (&density[..], &pressure[..]);
    acceleration.resize(n, [0.0; 3]);
    each_chunk(acceleration, CHUNK, parallel, |first, out| {
        pushes::<K>(gas, x, v, density, pressure, cells, first, out);
    });
}

/// Calls `f` with each chunk of `all` and the index of its first element.
pub(super) fn each_chunk<T: Send>(
    all: &mut [T],
    size: usize,
    parallel: bool,
    f: impl Fn(usize, &mut [T]) + Sync + Send,
) {
    if parallel {
        all.par_chunks_mut(size).enumerate().for_each(|(k, out)| f(k * size, out));
    } else {
        all.chunks_mut(size).enumerate().for_each(|(k, out)| f(k * size, out));
    }
}

/// Calls a function that is generic over [`SphLanes`], with the widest lanes of the processor.
macro_rules! by_width {
    ($name:ident, $kernel:ident, ($($arg:ident: $type:ty),*)) => {
        fn $name<K: KernelShape>($($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide<K: KernelShape>($($arg: $type),*) {
                    $kernel::<K, super::lanes::Avx2Lanes>($($arg),*);
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    #[expect(unsafe_code, reason = "the feature was just checked")]
                    // SAFETY: the processor has AVX2.
                    return unsafe { wide::<K>($($arg),*) };
                }
            }
            $kernel::<K, PortableLanes>($($arg),*);
        }
    };
}

by_width!(densities, densities_of, (gas: &Gas, x: &[Vec<f32>; 3], cells: &CellGrid, first: usize, out: &mut [f32]));
by_width!(pushes, pushes_on, (
    gas: &Gas, x: &[Vec<f32>; 3], v: &[Vec<f32>; 3], density: &[f32], pressure: &[f32], cells: &CellGrid,
    first: usize, out: &mut [[f32; 3]]
));

#[inline(always)]
fn at(x: &[Vec<f32>; 3], i: usize) -> [f32; 3] {
    [x[0][i], x[1][i], x[2][i]]
}

// Not `map` of arrays: it is not inlined into functions that enable AVX2.
#[inline(always)]
fn splat<L: SphLanes>(a: [f32; 3]) -> [L; 3] {
    [L::splat(a[0]), L::splat(a[1]), L::splat(a[2])]
}

/// Returns the values of a run and the padding after it, so that eight values can be read from every index.
#[inline(always)]
fn cut(values: &[f32], run: (u32, u32)) -> &[f32] {
    &values[run.0 as usize..run.1 as usize + WIDTH]
}

/// Computes the offset of a particle from eight others, and its square. Beyond the first `count` lanes, the square is
/// that of the support, where kernels are zero.
#[inline(always)]
fn offsets<L: SphLanes>(a: [L; 3], x: [&[f32]; 3], j: usize, count: u32, support2: L) -> ([L; 3], L) {
    let d = [a[0] - L::of(x[0], j), a[1] - L::of(x[1], j), a[2] - L::of(x[2], j)];
    let r2 = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).min(support2);
    (d, if count < WIDTH as u32 { r2.first(count, support2) } else { r2 })
}

#[inline(always)]
fn densities_of<K: KernelShape, L: SphLanes>(
    gas: &Gas,
    x: &[Vec<f32>; 3],
    cells: &CellGrid,
    first: usize,
    out: &mut [f32],
) {
    let h = gas.support;
    let (support2, inverse) = (L::splat(h * h), L::splat(1.0 / h));
    let scale = gas.mass / (K::VOLUME * h * h * h);
    for (k, density) in out.iter_mut().enumerate() {
        let here = at(x, first + k);
        let a: [L; 3] = splat(here);
        let mut sum = L::splat(0.0);
        for run in cells.around(here) {
            let (count, places) = (run.1 - run.0, [cut(&x[0], run), cut(&x[1], run), cut(&x[2], run)]);
            let mut j = 0;
            while j < count {
                let (_, r2) = offsets(a, places, j as usize, count - j, support2);
                sum = sum + K::value(r2.sqrt() * inverse);
                j += WIDTH as u32;
            }
        }
        *density = sum.sum() * scale;
    }
}

#[inline(always)]
fn pushes_on<K: KernelShape, L: SphLanes>(
    gas: &Gas,
    x: &[Vec<f32>; 3],
    v: &[Vec<f32>; 3],
    density: &[f32],
    pressure: &[f32],
    cells: &CellGrid,
    first: usize,
    out: &mut [[f32; 3]],
) {
    let h = gas.support;
    let zero = L::splat(0.0);
    let (support2, inverse) = (L::splat(h * h), L::splat(1.0 / h));
    let soft = L::splat(0.0025 * h * h);
    // −α c (H/2) · 2, because the mean density is half of a sum.
    let viscosity = L::splat(-gas.viscosity * gas.sound_speed * h);
    let scale = gas.mass / (K::VOLUME * h.powi(5));
    for (k, acceleration) in out.iter_mut().enumerate() {
        let i = first + k;
        let here = at(x, i);
        let (a, b): ([L; 3], [L; 3]) = (splat(here), splat(at(v, i)));
        let (own_pressure, own_density) = (L::splat(pressure[i]), L::splat(density[i]));
        let mut sum = [zero; 3];
        for run in cells.around(here) {
            let (count, places) = (run.1 - run.0, [cut(&x[0], run), cut(&x[1], run), cut(&x[2], run)]);
            let v = [cut(&v[0], run), cut(&v[1], run), cut(&v[2], run)];
            let (density, pressure) = (cut(density, run), cut(pressure, run));
            let mut j = 0;
            while j < count {
                let at = j as usize;
                let (d, r2) = offsets(a, places, at, count - j, support2);
                j += WIDTH as u32;
                if !r2.any_below(support2) {
                    continue;
                }
                let approach = ((b[0] - L::of(v[0], at)) * d[0]
                    + (b[1] - L::of(v[1], at)) * d[1]
                    + (b[2] - L::of(v[2], at)) * d[2])
                    .min(zero);
                let damping =
                    viscosity * approach * ((r2 + soft) * (own_density + L::of(density, at))).reciprocal();
                let push = (own_pressure + L::of(pressure, at) + damping) * K::slope(r2.sqrt() * inverse);
                sum[0] = sum[0] + push * d[0];
                sum[1] = sum[1] + push * d[1];
                sum[2] = sum[2] + push * d[2];
            }
        }
        *acceleration = [sum[0].sum() * scale, sum[1].sum() * scale, sum[2].sum() * scale];
    }
}
