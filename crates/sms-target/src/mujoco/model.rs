//! Writes a scene as MJCF text for the target, with one contact rule for all pairs.
//!
//! The MJCF of `sms-export` serves other programs and sets friction and restitution per geom. Here every pair with a
//! ball, the ground, another fixed body or the striker is an explicit contact pair, with the mean of both coefficients
//! as in our contact rule. MuJoCo finds pairs of two other moving bodies itself, with the larger friction and without
//! rebound.

use glamx::{DPose3, DQuat, DVec3};
use sms_core::Mesh;
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::BodyId;
use std::fmt::Write;

/// Angular frequency of contacts, rad/s: an impact takes half a period, 0.6 ms, and penetrates 0.2 mm at 1 m/s.
pub(super) const CONTACT_FREQUENCY: f64 = 5000.0;
/// Longest time step, seconds: 12 per half period of a contact.
pub(super) const LONGEST_STEP_S: f64 = 5e-5;
/// Damping ratio of contacts that do not bounce: they absorb the whole speed within one longest step.
const MOST_DAMPED: f64 = 2.0;
/// Share of the contact equation that is solved exactly; the rest is regularisation.
const IMPEDANCE: f64 = 0.999;
/// Rate at which friction reduces slip, 1/s. In MuJoCo's cone, slip pushes bodies apart: a rate of 4e4 removes a third
/// of the rebound of an oblique impact between rough balls and deflects them by 7°; at 1e3 they separate before they
/// stick, with the same error to the other side. In between, errors are below 1.5°.
const FRICTION_RATE: f64 = 5000.0;
/// Margin beyond every body of the slab that models a half space, metres. A slab, because MuJoCo finds at most three
/// contacts between a plane and a mesh.
const SLAB_MARGIN: f64 = 6.0;
const SLAB_HALF_DEPTH: f64 = 0.5;
/// Thickness of the prisms that model static triangles, metres, and their smallest area, m².
const PRISM_THICKNESS: f64 = 0.003;
const MIN_PRISM_AREA: f64 = 1e-8;
/// Mass of a kinematic body, kg, and its moments of inertia, kg·m²: too large for an impact to change its velocity,
/// which is set again before each time step.
const KINEMATIC_MASS: f64 = 1e6;

/// A kinematic body of a model.
#[derive(Debug, Clone, Copy)]
pub(super) struct KinematicSpec {
    /// Half extents of its box, metres.
    pub(super) half: DVec3,
    pub(super) x_wk: DPose3,
    pub(super) friction: f64,
    pub(super) restitution: f64,
    pub(super) enabled: bool,
    /// Mass of a tool, which contacts push but do not turn, kg; `None` for an unstoppable body.
    pub(super) mass: Option<f64>,
}

#[derive(Clone, Copy, PartialEq)]
enum Part {
    Static,
    Ball,
    Dynamic,
    Kinematic,
    Tool,
}

struct Geom {
    name: String,
    body: usize,
    part: Part,
    friction: f64,
    restitution: f64,
}

struct Writer {
    assets: String,
    world: String,
    geoms: Vec<Geom>,
}

/// Writes the MJCF text of the bodies for which `present` is true, and of the kinematic bodies. Moving bodies have free
/// joints, in the order of the scene, kinematic ones last.
pub(super) fn text(scene: &Scene, present: &dyn Fn(BodyId) -> bool, kinematics: &[KinematicSpec]) -> String {
    let mut w = Writer { assets: String::new(), world: String::new(), geoms: Vec::new() };
    let reach = scene.bodies.iter().map(|b| b.x_wb.translation.abs().max_element()).fold(0.0, f64::max);
    for (index, body) in scene.bodies.iter().enumerate().filter(|(index, _)| present(*index)) {
        w.body(index, body, reach + SLAB_MARGIN);
    }
    for (k, kinematic) in kinematics.iter().enumerate() {
        w.kinematic(scene.bodies.len() + k, kinematic);
    }
    format!(
        r#"<mujoco>
<compiler angle="radian" autolimits="true" boundmass="0" boundinertia="0" balanceinertia="false"/>
<option timestep="{LONGEST_STEP_S}" gravity="{}" integrator="Euler" cone="elliptic" impratio="10" tolerance="1e-12">
<flag autoreset="disable"/>
</option>
<default><geom contype="0" conaffinity="0" condim="3" solimp="{IMPEDANCE} {IMPEDANCE} 0.001"/></default>
<asset>
{}</asset>
<worldbody>
{}</worldbody>
<contact>
{}</contact>
</mujoco>
"#,
        numbers(scene.gravity_w.to_array()),
        w.assets,
        w.world,
        w.pairs(),
    )
}

impl Writer {
    fn body(&mut self, index: usize, body: &Body, slab_half_edge: f64) {
        let part = match (body.kind, &body.shape) {
            (BodyKind::Static, _) => Part::Static,
            (_, BodyShape::Sphere { .. }) => Part::Ball,
            _ => Part::Dynamic,
        };
        self.open(&body.x_wb, "");
        if let (BodyKind::Dynamic, Some(mass)) = (body.kind, &body.mass) {
            let (moments, axes) = mass.principal();
            let _ = writeln!(
                self.world,
                r#"<freejoint/><inertial pos="{}" quat="{}" mass="{:e}" diaginertia="{}"/>"#,
                numbers(mass.com().to_array()),
                wxyz(&axes),
                mass.mass(),
                numbers(moments.to_array()),
            );
        }
        let surface = (body.material.friction.value.best, body.material.restitution.value.best);
        let mut geom = |shape: &str| self.geom(index, part, surface, shape);
        match &body.shape {
            BodyShape::Sphere { radius } => geom(&format!(r#"type="sphere" size="{radius:e}""#)),
            BodyShape::Box { half_extents } => {
                geom(&format!(r#"type="box" size="{}""#, numbers(half_extents.to_array())));
            }
            BodyShape::Cylinder { radius, half_length } => {
                geom(&format!(r#"type="cylinder" size="{}""#, numbers([*radius, *half_length])));
            }
            BodyShape::HalfSpace => geom(&format!(
                r#"type="box" size="{}" pos="0 0 -{SLAB_HALF_DEPTH}""#,
                numbers([slab_half_edge, slab_half_edge, SLAB_HALF_DEPTH])
            )),
            BodyShape::Hulls { hulls } => {
                for hull in hulls {
                    self.mesh(index, part, surface, &hull.vertices);
                }
            }
            BodyShape::TriMesh { mesh } => {
                for t in 0..mesh.triangles.len() {
                    if let Some(prism) = prism(mesh, t) {
                        self.mesh(index, part, surface, &prism);
                    }
                }
            }
        }
        self.world.push_str("</body>\n");
    }

    fn kinematic(&mut self, index: usize, k: &KinematicSpec) {
        self.open(&k.x_wk, r#" gravcomp="1""#);
        let _ = writeln!(
            self.world,
            r#"<freejoint/><inertial pos="0 0 0" mass="{:e}" diaginertia="{}"/>"#,
            k.mass.unwrap_or(KINEMATIC_MASS),
            numbers([KINEMATIC_MASS; 3])
        );
        let shape = format!(r#"type="box" size="{}""#, numbers(k.half.to_array()));
        if k.enabled {
            let part = if k.mass.is_some() { Part::Tool } else { Part::Kinematic };
            self.geom(index, part, (k.friction, k.restitution), &shape);
        }
        self.world.push_str("</body>\n");
    }

    fn open(&mut self, x_wb: &DPose3, more: &str) {
        let (at, turn) = (numbers(x_wb.translation.to_array()), wxyz(&x_wb.rotation));
        let _ = writeln!(self.world, r#"<body pos="{at}" quat="{turn}"{more}>"#);
    }

    fn mesh(&mut self, body: usize, part: Part, surface: (f64, f64), vertices: &[DVec3]) {
        let name = format!("m{}", self.geoms.len());
        let vertices = numbers(vertices.iter().flat_map(|v| v.to_array()));
        let _ = writeln!(self.assets, r#"<mesh name="{name}" vertex="{vertices}" inertia="shell"/>"#);
        self.geom(body, part, surface, &format!(r#"type="mesh" mesh="{name}""#));
    }

    fn geom(&mut self, body: usize, part: Part, (friction, restitution): (f64, f64), shape: &str) {
        let name = format!("g{}", self.geoms.len());
        // MuJoCo finds the contacts between moving bodies other than balls.
        let search = if part == Part::Dynamic { r#" contype="1" conaffinity="1""# } else { "" };
        let _ = writeln!(
            self.world,
            r#"<geom name="{name}"{search} friction="{friction:e} 0 0" solref="{}" {shape}/>"#,
            spring(restitution)
        );
        self.geoms.push(Geom { name, body, part, friction, restitution });
    }

    /// Writes every pair with a moving body, except those that MuJoCo finds itself.
    fn pairs(&self) -> String {
        let mut text = String::new();
        for (i, a) in self.geoms.iter().enumerate() {
            for b in &self.geoms[i + 1..] {
                let moves = |g: &Geom| matches!(g.part, Part::Ball | Part::Dynamic | Part::Tool);
                let both_found = a.part == Part::Dynamic && b.part == Part::Dynamic;
                if a.body == b.body || both_found || !(moves(a) || moves(b)) {
                    continue;
                }
                let friction = 0.5 * (a.friction + b.friction);
                let restitution = 0.5 * (a.restitution + b.restitution);
                let _ = writeln!(
                    text,
                    r#"<pair geom1="{}" geom2="{}" condim="{}" friction="{friction:e} {friction:e} 0 0 0" solref="{}" solreffriction="-1 -{FRICTION_RATE:e}" solimp="{IMPEDANCE} {IMPEDANCE} 0.001"/>"#,
                    a.name,
                    b.name,
                    if friction > 0.0 { 3 } else { 1 },
                    spring(restitution)
                );
            }
        }
        text
    }
}

/// Returns the stiffness and damping (`solref`) of contacts with coefficient of restitution `restitution`.
fn spring(restitution: f64) -> String {
    let damper = 2.0 * damping_ratio(restitution) * CONTACT_FREQUENCY;
    format!("-{:e} -{damper:e}", CONTACT_FREQUENCY * CONTACT_FREQUENCY)
}

/// Computes the damping ratio of contacts with coefficient of restitution `restitution`, by bisection on [`rebound`].
fn damping_ratio(restitution: f64) -> f64 {
    let (mut low, mut high) = (0.0, MOST_DAMPED);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if rebound(middle) > restitution { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Computes the coefficient of restitution of a spring and damper that does not pull, with the time steps of this
/// target. The impact begins at the start of a step; in the limit of short steps the result is that of Schwager and
/// Pöschel (2007, eq. 19).
fn rebound(ratio: f64) -> f64 {
    let h = LONGEST_STEP_S * CONTACT_FREQUENCY;
    let (mut x, mut v) = (-h, -1.0);
    while x < 0.0 {
        v += h * (-2.0 * ratio * v - x).max(0.0);
        x += h * v;
        if v > 0.0 && -2.0 * ratio * v - x <= 0.0 {
            break;
        }
    }
    v.max(0.0)
}

/// Returns the corners of a triangle and of its copy below.
fn prism(mesh: &Mesh, triangle: usize) -> Option<Vec<DVec3>> {
    let corners = mesh.corners(triangle);
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    if 0.5 * normal.length() < MIN_PRISM_AREA {
        return None;
    }
    let down = -normal.normalize_or(DVec3::Z) * PRISM_THICKNESS;
    Some(corners.iter().copied().chain(corners.iter().map(|&c| c + down)).collect())
}

fn wxyz(q: &DQuat) -> String {
    numbers([q.w, q.x, q.y, q.z])
}

fn numbers(values: impl IntoIterator<Item = f64>) -> String {
    let mut text = String::new();
    for v in values {
        let _ = write!(text, "{}{v:e}", if text.is_empty() { "" } else { " " });
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contacts_give_back_what_they_are_made_for() {
        for restitution in [0.1, 0.3, 0.5, 0.8, 0.95] {
            let back = rebound(damping_ratio(restitution));
            assert!((back - restitution).abs() < 0.03, "{restitution}: {back}");
        }
        // A contact without restitution still rebounds with a sixteenth of the speed: the spring pushes the body out.
        assert!(rebound(damping_ratio(0.0)) < 0.07);
        assert!(damping_ratio(0.0) > damping_ratio(0.5) && damping_ratio(0.5) > damping_ratio(0.95));
    }
}
