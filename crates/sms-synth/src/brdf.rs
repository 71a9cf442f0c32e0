//! Reflection of surfaces: a microfacet lobe over a diffuse base; metals have the lobe only.
//!
//! The lobe has the GGX distribution with the height-correlated Smith term (Walter et al. 2007, "Microfacet Models for
//! Refraction through Rough Surfaces"; Heitz 2014, "Understanding the Masking-Shadowing Function") and Schlick's Fresnel
//! factor; the base reflects the rest (Ashikhmin & Shirley 2000). Radiances are in units of irradiance / π, so that a
//! white diffuse surface under irradiance π·e has radiance e.

use glamx::Vec3;
use std::sync::LazyLock;

/// Reflectance of a dielectric at normal incidence (index of refraction 1.5).
const DIELECTRIC: f32 = 0.04;
/// Makes the base conserve energy: 21/20 for Schlick's factor (Ashikhmin & Shirley 2000).
const BASE: f32 = 1.05;
/// Mean of `BASE · (1 − F)` over a cosine-weighted hemisphere.
const BASE_UNDER_SKY: f32 = BASE * (1.0 - DIELECTRIC) * (1.0 - 1.0 / 21.0);
/// Smallest roughness α: no household object is optically flat, and single precision needs it.
const SMOOTHEST: f32 = 0.02;

/// A surface point's reflection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reflectance {
    /// Linear albedo of the diffuse base.
    diffuse: Vec3,
    /// Reflectance of the lobe at normal incidence.
    f0: Vec3,
    /// GGX roughness α, the square of the perceptual roughness.
    pub(crate) alpha: f32,
}

impl Reflectance {
    /// Creates the reflection of a linear `albedo`, `gloss` 0 (matte) to 1 (polished) and `metalness` 0 to 1 (Burley 2012, "Physically Based
    /// Shading at Disney": perceptual roughness is 1 − 0.9 gloss, its square α).
    pub(crate) fn new(albedo: Vec3, gloss: f32, metalness: f32) -> Self {
        let roughness = 1.0 - 0.9 * gloss.clamp(0.0, 1.0);
        Self {
            diffuse: albedo * (1.0 - metalness),
            f0: Vec3::splat(DIELECTRIC).lerp(albedo, metalness),
            alpha: (roughness * roughness).max(SMOOTHEST),
        }
    }

    /// Returns whether most of its light is reflected by the lobe.
    pub(crate) fn is_metal(&self) -> bool {
        self.f0.max_element() > 0.3
    }

    /// Returns π · BRDF · cos of light from `l` towards `v` (unit vectors on the side of the unit normal `n`), for a light with the
    /// half-angle tangent `spread`: it widens the lobe and keeps its energy.
    pub(crate) fn reflect(&self, n: Vec3, v: Vec3, l: Vec3, spread: f32) -> Vec3 {
        let (nl, nv) = (n.dot(l), n.dot(v).max(1e-3));
        if nl <= 0.0 {
            return Vec3::ZERO;
        }
        let half = (v + l).normalize_or_zero();
        let (nh, vh) = (n.dot(half).clamp(0.0, 1.0), v.dot(half).clamp(0.0, 1.0));
        // A light's half-angle turns the half vector by half that angle.
        let a2 = self.alpha * self.alpha + 0.25 * spread * spread;
        let base = self.diffuse * (BASE * (1.0 - schlick(DIELECTRIC, nl)) * (1.0 - schlick(DIELECTRIC, nv)));
        (base + self.lobe(nl, nv, nh, vh, a2)) * nl
    }

    /// π · D · V · F.
    fn lobe(&self, nl: f32, nv: f32, nh: f32, vh: f32, a2: f32) -> Vec3 {
        let d = (1.0 - nh * nh) + a2 * nh * nh;
        let smith = |a: f32, b: f32| a * (b * b * (1.0 - a2) + a2).sqrt();
        let visibility = 0.5 / (smith(nl, nv) + smith(nv, nl));
        let grazing = (1.0 - vh).powi(5);
        (self.f0 + (Vec3::ONE - self.f0) * grazing) * (a2 / (d * d) * visibility)
    }

    /// Returns the share of a uniform sky that the base reflects towards a viewer at `nv` = cos of the angle to the normal.
    pub(crate) fn base_share(&self, nv: f32) -> Vec3 {
        self.diffuse * (BASE_UNDER_SKY * (1.0 - schlick(DIELECTRIC, nv)))
    }

    /// Returns the share of uniform surroundings that the lobe reflects towards a viewer at `nv`.
    pub(crate) fn lobe_share(&self, nv: f32) -> Vec3 {
        let [of_f0, of_one] = LOBE_SHARES.at(nv, self.alpha.sqrt());
        self.f0 * of_f0 + Vec3::splat(of_one)
    }

    /// Returns the light of a projector beside the camera that comes back, relative to a white diffuse surface viewed face on,
    /// without the cosine of incidence `nv`. Active stereo needs it: metals and dark surfaces return little at a slant,
    /// polished ones glare face on.
    pub(crate) fn echo(&self, nv: f32) -> f32 {
        let nv = nv.clamp(0.05, 1.0);
        let lobe = self.lobe(nv, nv, nv, 1.0, self.alpha * self.alpha);
        // Silicon is sensitive to near infrared, where many dyes are clear: the mean of the channels fits better than luminance.
        (self.base_share(nv) + lobe).element_sum() / 3.0
    }

    /// Samples a direction into which light from `v` is reflected off one visible microfacet, for uniform `u` in [0, 1)² (Dupuy &
    /// Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps"); may point below the surface.
    pub(crate) fn mirrored(&self, n: Vec3, v: Vec3, u: [f32; 2]) -> Vec3 {
        let (tangent, other) = n.any_orthonormal_pair();
        let local = Vec3::new(v.dot(tangent), v.dot(other), v.dot(n).max(1e-3));
        let stretch = |w: Vec3| Vec3::new(w.x * self.alpha, w.y * self.alpha, w.z).normalize();
        let stretched = stretch(local);
        let z = (1.0 - u[1]) * (1.0 + stretched.z) - stretched.z;
        let (sin, cos) = (std::f32::consts::TAU * u[0]).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        let half = stretch(Vec3::new(r * cos, r * sin, z) + stretched);
        let half = tangent * half.x + other * half.y + n * half.z;
        half * (2.0 * v.dot(half)) - v
    }
}

/// The lobe's share of uniform surroundings is `f0 · a + b`: `[a, b]` by cosine and perceptual roughness (Karis 2013, "Real
/// Shading in Unreal Engine 4"), integrated when first needed.
struct LobeShares {
    values: Vec<[f32; 2]>,
}

const STEPS: usize = 32;
static LOBE_SHARES: LazyLock<LobeShares> = LazyLock::new(LobeShares::integrate);

impl LobeShares {
    fn integrate() -> Self {
        const RAYS: usize = 256;
        let values = (0..(STEPS + 1) * (STEPS + 1)).map(|i| {
            let at = |k: usize| k as f32 / STEPS as f32;
            let (nv, roughness) = (at(i % (STEPS + 1)).max(0.01), at(i / (STEPS + 1)));
            let finish = Reflectance {
                diffuse: Vec3::ZERO,
                f0: Vec3::ONE,
                alpha: (roughness * roughness).max(SMOOTHEST),
            };
            let a2 = finish.alpha * finish.alpha;
            let lambda = |c: f32| 0.5 * ((1.0 + a2 * (1.0 - c * c) / (c * c)).sqrt() - 1.0);
            let v = Vec3::new((1.0 - nv * nv).sqrt(), 0.0, nv);
            let mut sum = [0.0; 2];
            for k in 0..RAYS {
                let u = [(k as f32 + 0.5) / RAYS as f32, (k as f32 * 0.618_034).fract()];
                let l = finish.mirrored(Vec3::Z, v, u);
                if l.z > 0.0 {
                    let kept = (1.0 + lambda(nv)) / (1.0 + lambda(nv) + lambda(l.z));
                    let grazing = (1.0 - v.dot((v + l).normalize()).clamp(0.0, 1.0)).powi(5);
                    sum[0] += kept * (1.0 - grazing) / RAYS as f32;
                    sum[1] += kept * grazing / RAYS as f32;
                }
            }
            sum
        });
        Self { values: values.collect() }
    }

    fn at(&self, nv: f32, roughness: f32) -> [f32; 2] {
        let place = |v: f32| {
            let v = v.clamp(0.0, 1.0) * STEPS as f32;
            let i = (v as usize).min(STEPS - 1);
            (i, v - i as f32)
        };
        let ((i, fi), (j, fj)) = (place(nv), place(roughness));
        let row = |j: usize, c: usize| {
            let (a, b) = (self.values[j * (STEPS + 1) + i][c], self.values[j * (STEPS + 1) + i + 1][c]);
            a + (b - a) * fi
        };
        [0, 1].map(|c| row(j, c) + (row(j + 1, c) - row(j, c)) * fj)
    }
}

/// Schlick's Fresnel factor.
fn schlick(f0: f32, cos: f32) -> f32 {
    f0 + (1.0 - f0) * (1.0 - cos.clamp(0.0, 1.0)).powi(5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directions and weights of a midpoint rule over the hemisphere around z: ∫ f cos / π ≈ Σ w f.
    fn hemisphere(steps: usize) -> impl Iterator<Item = (Vec3, f32)> {
        let count = steps * 2 * steps;
        (0..count).map(move |i| {
            let (a, b) = (i / (2 * steps), i % (2 * steps));
            let square = (a as f32 + 0.5) / steps as f32;
            let (sin, cos) = ((b as f32 + 0.5) / (2 * steps) as f32 * std::f32::consts::TAU).sin_cos();
            let (r, z) = (square.sqrt(), (1.0 - square).sqrt());
            (Vec3::new(r * cos, r * sin, z), 1.0 / count as f32)
        })
    }

    fn viewer(nv: f32) -> Vec3 {
        Vec3::new((1.0 - nv * nv).sqrt(), 0.0, nv)
    }

    /// Share of a uniform sky of radiance 1 that reaches the viewer.
    fn furnace(finish: &Reflectance, nv: f32) -> f32 {
        hemisphere(400).map(|(l, w)| finish.reflect(Vec3::Z, viewer(nv), l, 0.0).x / l.z * w).sum::<f32>()
    }

    #[test]
    fn a_white_furnace_gets_no_more_back_than_it_gives() {
        for gloss in [0.0, 0.3, 0.5, 0.7, 0.85] {
            for nv in [0.15, 0.4, 0.7, 1.0] {
                let dielectric = furnace(&Reflectance::new(Vec3::ONE, gloss, 0.0), nv);
                let metal = furnace(&Reflectance::new(Vec3::ONE, gloss, 1.0), nv);
                assert!(dielectric < 1.01 && dielectric > 0.5, "gloss {gloss}, cos {nv}: {dielectric}");
                // One bounce between facets only: rough metals lose the energy of the second (Heitz 2014).
                assert!(metal < 1.01 && metal > 0.3, "gloss {gloss}, cos {nv}: {metal}");
                if gloss > 0.6 && nv > 0.3 {
                    assert!(metal > 0.9, "a polished white metal reflects nearly all: {metal}");
                }
            }
        }
    }

    #[test]
    fn shares_of_a_uniform_sky_are_the_integrals() {
        for (gloss, metalness) in [(0.3, 0.0), (0.6, 0.0), (0.8, 0.0), (0.3, 1.0), (0.6, 1.0), (0.8, 1.0)] {
            let finish = Reflectance::new(Vec3::splat(0.6), gloss, metalness);
            for nv in [0.3, 0.6, 1.0] {
                let (sum, exact) = ((finish.base_share(nv) + finish.lobe_share(nv)).x, furnace(&finish, nv));
                assert!((sum - exact).abs() < 0.015, "{gloss} {metalness} {nv}: {sum} {exact}");
            }
        }
    }

    #[test]
    fn light_and_viewer_may_be_exchanged_and_a_wide_light_keeps_its_energy() {
        let finish = Reflectance::new(Vec3::new(0.5, 0.3, 0.1), 0.6, 0.4);
        let (a, b) = (Vec3::new(0.3, 0.2, 0.8).normalize(), Vec3::new(-0.5, 0.4, 0.5).normalize());
        let (ab, ba) = (finish.reflect(Vec3::Z, a, b, 0.1) / b.z, finish.reflect(Vec3::Z, b, a, 0.1) / a.z);
        assert!((ab - ba).length() < 1e-5);
        let glossy = Reflectance::new(Vec3::ONE, 0.7, 1.0);
        let wide = hemisphere(400)
            .map(|(l, w)| glossy.reflect(Vec3::Z, viewer(0.8), l, 0.2).x / l.z * w)
            .sum::<f32>();
        assert!((wide - furnace(&glossy, 0.8)).abs() < 0.03, "{wide}");
    }

    #[test]
    fn sampled_directions_follow_the_lobe() {
        // The mean of a test function over sampled directions, weighted with Smith's term, is its integral against the lobe.
        let finish = Reflectance::new(Vec3::ONE, 0.5, 1.0);
        let v = viewer(0.7);
        let exact =
            hemisphere(400).map(|(l, w)| finish.reflect(Vec3::Z, v, l, 0.0) / l.z * w * l.x).sum::<Vec3>().x;
        let n = 200;
        let a2 = finish.alpha * finish.alpha;
        let lambda = |c: f32| 0.5 * ((1.0 + a2 * (1.0 - c * c) / (c * c)).sqrt() - 1.0);
        let sampled: f32 = (0..n * n)
            .map(|i| {
                let u = [(i % n) as f32 / n as f32, ((i / n) as f32 + 0.5) / n as f32];
                let l = finish.mirrored(Vec3::Z, v, u);
                if l.z <= 0.0 {
                    return 0.0;
                }
                let (one, both) = (1.0 / (1.0 + lambda(v.z)), 1.0 / (1.0 + lambda(v.z) + lambda(l.z)));
                l.x * both / one
            })
            .sum::<f32>()
            / (n * n) as f32;
        assert!((sampled - exact).abs() < 0.01, "{sampled} {exact}");
    }

    #[test]
    fn black_rubber_and_slanted_metal_return_little_and_a_polished_ball_glares() {
        let echo = |albedo: f32, gloss: f32, metalness: f32, nv: f32| {
            Reflectance::new(Vec3::splat(albedo), gloss, metalness).echo(nv)
        };
        assert!((echo(0.8, 0.0, 0.0, 1.0) - 0.75).abs() < 0.06);
        assert!(echo(0.008, 0.3, 0.0, 0.6) < 0.02);
        assert!(echo(0.6, 0.65, 1.0, 0.5) < 0.05 && echo(0.6, 0.65, 1.0, 1.0) > 1.0);
        assert!(echo(0.5, 0.9, 0.0, 1.0) > 5.0 && echo(0.5, 0.9, 0.0, 0.9) < 1.0);
    }
}
