//! The two analytic models. A stream is a bundle of flow lines with equal shares of the momentum. Each flow line
//! transfers its momentum to the first surface on its way.

use crate::jet::RoundJet;
use crate::surface::is_apart;
use crate::wash::Stream;
use crate::{BodyState, BodySurface, Emission, Emitted, VehicleState, Wash, WashError, Wrench};
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::Aabb;
use std::f64::consts::PI;

/// Settings of the analytic models.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StreamSettings {
    /// Density of the air, kg/m³.
    pub air_density: f64,
    /// Momentum of a propeller's stream.
    pub emission: Emission,
    /// Number of flow lines of a propeller from its axis outwards.
    pub rings: usize,
    /// Number of flow lines around the axis.
    pub spokes: usize,
    /// Length of the flow lines, metres. A merged jet has a third of the exit speed there.
    pub reach: f64,
    /// Distance at which the jets of all propellers have merged, in multiples of the largest distance between motors
    /// (measured: 2.5, arXiv 2403.13321).
    pub merge_spans: f64,
    /// Number of pieces of a curved flow line; they are shorter near the propeller.
    pub pieces: usize,
}

impl Default for StreamSettings {
    fn default() -> Self {
        Self {
            air_density: crate::disk::AIR_DENSITY,
            emission: Emission::Momentum,
            rings: 10,
            spokes: 16,
            reach: 2.0,
            merge_spans: 2.5,
            pieces: 10,
        }
    }
}

/// Model of a propeller's stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum StreamModel {
    Tube,
    Jet,
}

/// Quasi-steady wash: the flow follows the current thrusts, and its axis is bent by the vehicle's current velocity.
/// Each flow line loses the component of its momentum along the normal of the first surface that it meets. The air
/// behind surfaces is still.
pub struct StreamWash {
    shape: StreamModel,
    settings: StreamSettings,
    surfaces: Vec<BodySurface>,
    active: bool,
    /// Cosine and sine of each flow line's angle. Rings are rotated, so that an edge crosses lines one by one.
    turns: Vec<(f64, f64)>,
    /// One profile per propeller, reused while thrusts are constant.
    profiles: Vec<StreamProfile>,
}

/// Widening and decay of a propeller's stream.
#[derive(Debug, Clone, Default)]
struct StreamProfile {
    emitted: Option<Emitted>,
    /// For each ring, the distance from the axis and the speed at the ends of pieces.
    rings: Vec<Vec<(f64, f64)>>,
}

impl StreamWash {
    /// `disk`: uniform tubes of constant width and speed.
    ///
    /// # Errors
    /// [`WashError::Setting`] when a setting is out of range.
    pub fn disk(surfaces: Vec<BodySurface>, settings: StreamSettings) -> Result<Self, WashError> {
        Self::new(StreamModel::Tube, surfaces, settings)
    }

    /// `jet`: turbulent round jets ([`RoundJet`]) that converge until they merge.
    ///
    /// # Errors
    /// [`WashError::Setting`] when a setting is out of range.
    pub fn jet(surfaces: Vec<BodySurface>, settings: StreamSettings) -> Result<Self, WashError> {
        Self::new(StreamModel::Jet, surfaces, settings)
    }

    fn new(
        shape: StreamModel,
        surfaces: Vec<BodySurface>,
        settings: StreamSettings,
    ) -> Result<Self, WashError> {
        WashError::positive("air_density", settings.air_density)?;
        WashError::positive("rings", settings.rings as f64)?;
        WashError::positive("spokes", settings.spokes as f64)?;
        WashError::positive("reach", settings.reach)?;
        WashError::positive("merge_spans", settings.merge_spans)?;
        WashError::positive("pieces", settings.pieces as f64)?;
        let turn = |ring: usize, spoke: usize| {
            2.0 * PI * (spoke as f64 + ring as f64 * 0.618_034) / settings.spokes as f64
        };
        let turns = (0..settings.rings)
            .flat_map(|ring| (0..settings.spokes).map(move |spoke| turn(ring, spoke)))
            .map(|turn| (turn.cos(), turn.sin()))
            .collect();
        Ok(Self { shape, settings, surfaces, active: false, turns, profiles: Vec::new() })
    }

    /// Computes the wrenches of the steady flow.
    fn evaluate(&mut self, vehicle: &VehicleState<'_>, bodies: &[BodyState], wrenches: &mut [Wrench]) {
        let streams: Vec<Stream> =
            vehicle.streams(self.settings.air_density, self.settings.emission).collect();
        let flux: f64 = streams.iter().map(|s| s.emitted.momentum_flux()).sum();
        if flux <= 0.0 {
            return;
        }
        let center_w: DVec3 = streams.iter().map(|s| s.p_w * (s.emitted.momentum_flux() / flux)).sum();
        let span = vehicle
            .rotors
            .iter()
            .flat_map(|a| vehicle.rotors.iter().map(|b| a.p_v.distance(b.p_v)))
            .fold(0.0, f64::max);
        self.profiles.resize_with(streams.len().max(self.profiles.len()), StreamProfile::default);
        for (at, stream) in streams.iter().enumerate() {
            if self.profiles[at].emitted != Some(stream.emitted) {
                self.profiles[at] =
                    StreamProfile { emitted: Some(stream.emitted), rings: self.rings(&stream.emitted) };
            }
        }
        let poses_bw: Vec<DPose3> = bodies.iter().map(|b| b.x_wb.inverse()).collect();
        let (rings, spokes) = (self.settings.rings, self.settings.spokes);
        let boxes_w: Vec<Option<Aabb>> =
            self.surfaces.iter().zip(bodies).map(|(s, b)| s.extent_w(&b.x_wb)).collect();
        let at = BodyPlacement { bodies, poses_bw: &poses_bw, boxes_w: &boxes_w };
        let mut near = Vec::with_capacity(bodies.len());
        for (stream, profile) in streams.iter().zip(&self.profiles) {
            let across = stream.p_w - center_w;
            let to_center = across - across.dot(stream.axis_w) * stream.axis_w;
            let merged_at = self.settings.merge_spans * span;
            let lines = self.flow_lines(stream, &profile.rings, to_center, merged_at, vehicle.v_w);
            near.clear();
            near.extend((0..bodies.len()).filter(|&b| self.in_reach(b, &lines, &bodies[b].x_wb)));
            if near.is_empty() {
                continue;
            }
            let share = stream.emitted.momentum_flux() / (rings * spokes) as f64;
            let (u, v) = stream.axis_w.any_orthonormal_pair();
            for (line, (cos, sin)) in self.turns.iter().enumerate() {
                let outwards_w = *cos * u + *sin * v;
                let line = FlowLine { ring: line / spokes, outwards_w, share };
                self.follow(&lines, line, &near, &at, wrenches);
            }
        }
    }

    /// The number of pieces, and the distances of their ends from the propeller, metres.
    fn pieces(&self) -> (usize, impl Fn(usize) -> f64) {
        let pieces = if self.shape == StreamModel::Tube { 1 } else { self.settings.pieces };
        let reach = self.settings.reach;
        (pieces, move |k| reach * (k as f64 / pieces as f64).powf(1.5))
    }

    /// Distances from the axis and speeds of the flow lines of a propeller.
    fn rings(&self, emitted: &Emitted) -> Vec<Vec<(f64, f64)>> {
        let (pieces, distance) = self.pieces();
        let jet = RoundJet {
            momentum_flux: emitted.momentum_flux(),
            exit_radius: emitted.radius,
            air_density: self.settings.air_density,
        };
        let ring = |ring: usize| {
            let inner = (ring as f64 + 0.5) / self.settings.rings as f64;
            let radius_and_speed = |k: usize| match self.shape {
                StreamModel::Tube => (emitted.radius * inner.sqrt(), emitted.speed),
                StreamModel::Jet => jet.stream(inner, distance(k)),
            };
            (0..=pieces).map(radius_and_speed).collect()
        };
        (0..self.settings.rings).map(ring).collect()
    }

    /// Returns the flow lines of a propeller.
    fn flow_lines<'a>(
        &self,
        stream: &Stream,
        rings: &'a [Vec<(f64, f64)>],
        to_center: DVec3,
        merged_at: f64,
        v_w: DVec3,
    ) -> FlowLines<'a> {
        let (pieces, distance) = self.pieces();
        // Air farther down left the propeller earlier, when the vehicle was elsewhere.
        let sideways_w = v_w - v_w.dot(stream.axis_w) * stream.axis_w;
        let (mut transit_s, mut last) = (0.0, (0.0, rings[0][0].1));
        let axis_w = (0..=pieces)
            .map(|k| {
                let (z, speed) = (distance(k), rings[0][k].1);
                transit_s += 2.0 * (z - last.0) / (speed + last.1);
                last = (z, speed);
                let u = if merged_at > 0.0 { (z / merged_at).min(1.0) } else { 1.0 };
                let drawn = if self.shape == StreamModel::Tube { 0.0 } else { u * u * (3.0 - 2.0 * u) };
                stream.p_w + z * stream.axis_w - drawn * to_center - transit_s * sideways_w
            })
            .collect();
        FlowLines {
            stream: *stream,
            axis_w,
            rings,
            aside: to_center.length() + transit_s * sideways_w.length(),
        }
    }

    /// Returns whether the flow lines can meet a body.
    fn in_reach(&self, body: usize, lines: &FlowLines<'_>, x_wb: &DPose3) -> bool {
        let Some(extent) = self.surfaces[body].extent() else { return true };
        let (radius, center_w) = (0.5 * extent.extents().length(), x_wb.transform_point(extent.center()));
        let to_center = center_w - lines.stream.p_w;
        let along = to_center.dot(lines.stream.axis_w);
        let widest = lines.rings.last().and_then(|r| r.last()).map_or(0.0, |(radius, _)| *radius);
        along + radius >= 0.0
            && along - radius <= self.settings.reach
            && (to_center - along * lines.stream.axis_w).length() <= radius + widest + lines.aside
    }

    /// Follows a flow line to the first surface and transfers its momentum to the surface.
    fn follow(
        &self,
        lines: &FlowLines<'_>,
        line: FlowLine,
        near: &[usize],
        placed: &BodyPlacement<'_>,
        wrenches: &mut [Wrench],
    ) {
        let BodyPlacement { bodies, poses_bw, boxes_w } = *placed;
        let FlowLine { ring, outwards_w, share } = line;
        let at = |k: usize| {
            let (radius, speed) = lines.rings[ring][k];
            (lines.axis_w[k] + radius * outwards_w, speed)
        };
        let (mut from_w, mut speed) = at(0);
        for k in 1..lines.axis_w.len() {
            let (to_w, next_speed) = at(k);
            let step = to_w - from_w;
            let length = step.length();
            let direction_w = step / length;
            let mut first: Option<(usize, f64, DVec3)> = None;
            let (low, high) = (from_w.min(to_w), from_w.max(to_w));
            for &b in near {
                if boxes_w[b].is_some_and(|around| is_apart(&around, low, high)) {
                    continue;
                }
                let limit = first.map_or(length, |f| f.1);
                let x_bw = &poses_bw[b];
                let origin_b = x_bw.transform_point(from_w);
                if let Some(hit) = self.surfaces[b].ray(origin_b, x_bw.rotation * direction_w, limit) {
                    first = Some((b, hit.distance, bodies[b].x_wb.rotation * hit.normal));
                }
            }
            if let Some((b, distance, normal_w)) = first {
                let p_w = from_w + distance * direction_w;
                let speed = speed + (next_speed - speed) * (distance / length);
                let receding = bodies[b].velocity_at(p_w).dot(direction_w);
                let relative = (1.0 - receding / speed.max(1e-9)).clamp(0.0, 2.0);
                // The share refers to momentum along the axis; an oblique line carries more.
                let facing = -direction_w.dot(normal_w) / direction_w.dot(lines.stream.axis_w).max(0.1);
                let force_w = normal_w * (-share * relative * relative * facing.max(0.0));
                wrenches[b].push(force_w, p_w, bodies[b].x_wb.translation);
                return;
            }
            (from_w, speed) = (to_w, next_speed);
        }
    }
}

/// Placement of the bodies.
struct BodyPlacement<'a> {
    bodies: &'a [BodyState],
    poses_bw: &'a [DPose3],
    /// World-space bounding boxes of the surfaces; `None` for unbounded ones.
    boxes_w: &'a [Option<Aabb>],
}

/// One flow line of a propeller.
struct FlowLine {
    /// Index of its ring.
    ring: usize,
    /// Direction from the axis, a unit vector in the world.
    outwards_w: DVec3,
    /// Share of the momentum flux, N.
    share: f64,
}

/// The flow lines of one propeller, in pieces.
struct FlowLines<'a> {
    stream: Stream,
    /// The axis at the ends of pieces, in the world.
    axis_w: Vec<DVec3>,
    /// For each ring, the distance from the axis and the speed at the ends of pieces.
    rings: &'a [Vec<(f64, f64)>],
    /// Largest offset of the bundle from the propeller's axis, by merging and by lag.
    aside: f64,
}

impl Wash for StreamWash {
    fn name(&self) -> &'static str {
        match self.shape {
            StreamModel::Tube => "disk",
            StreamModel::Jet => "jet",
        }
    }

    fn step(&mut self, _dt: f64, vehicle: &VehicleState<'_>, bodies: &[BodyState], wrenches: &mut [Wrench]) {
        assert_eq!(bodies.len(), self.surfaces.len(), "a motion for each surface");
        assert_eq!(wrenches.len(), self.surfaces.len(), "a wrench for each surface");
        assert_eq!(vehicle.rotors.len(), vehicle.thrusts.len(), "a thrust for each propeller");
        wrenches.fill(Wrench::default());
        self.evaluate(vehicle, bodies, wrenches);
        self.active = wrenches.iter().any(|w| w.force_w != DVec3::ZERO);
    }

    fn is_active(&self) -> bool {
        self.active
    }

    fn save(&mut self) {}

    fn restore(&mut self) {
        self.active = false;
    }
}
