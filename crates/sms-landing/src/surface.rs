//! Finds landing surfaces in a height map of the scene.

use crate::{LandingError, LandingTask, SurfaceLimits};
use glamx::{DMat2, DPose3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{Aabb, InputError, QuantileRule, quantile};
use sms_robots::Quadrotor;
use sms_scene::{BodyShape, Scene};
use sms_sim::wash_surfaces;
use sms_wash::BodySurface;

/// Cell size of the height map, metres.
const CELL_M: f64 = 0.01;
/// Largest number of cells along an edge: larger scenes get a coarser grid.
const MOST_CELLS: f64 = 800.0;
/// Largest height difference of neighbouring cells of one surface, without the slope, metres.
const STEP_M: f64 = 0.004;
/// Smallest area of a surface, square metres: smaller patches are noise of a reconstruction.
const LEAST_AREA_M2: f64 = 0.0025;

/// A level surface on which a vehicle can stand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingSurface {
    /// Name of its body.
    pub body: String,
    /// Height (the median of its cells), metres in the world.
    pub top_w: f64,
    /// Area, m².
    pub area_m2: f64,
    /// Centre of the bounding rectangle of the feasible positions of the vehicle's axis, world x and y, metres.
    pub center_w: [f64; 2],
    /// Unit vector along the rectangle's first edge, which is the surface's long axis.
    pub along_w: [f64; 2],
    /// Half lengths of the rectangle's edges, metres: along and across.
    pub half: [f64; 2],
    /// Corners of the bounding rectangle of the whole surface along its long axis, counterclockwise, world x and y,
    /// metres.
    pub outline_w: [[f64; 2]; 4],
    grid: Grid,
    /// Whether the vehicle fits with its axis in the cell: all feet on the surface, body and propellers free of
    /// obstacles.
    #[serde(with = "as_text")]
    fits: Vec<bool>,
}

/// Writes one character per cell.
mod as_text {
    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(fits: &[bool], serializer: S) -> Result<S::Ok, S::Error> {
        let text: String = fits.iter().map(|f| if *f { '#' } else { '.' }).collect();
        serializer.serialize_str(&text)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<bool>, D::Error> {
        Ok(String::deserialize(deserializer)?.chars().map(|c| c == '#').collect())
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Grid {
    min: DVec2,
    cell: f64,
    count: [usize; 2],
}

impl Grid {
    fn around(min: DVec2, max: DVec2) -> Self {
        let size = max - min;
        let cell = CELL_M.max(size.max_element() / MOST_CELLS);
        let count = size.to_array().map(|l| (l / cell).ceil().max(1.0) as usize);
        Self { min, cell, count }
    }

    fn len(&self) -> usize {
        self.count[0] * self.count[1]
    }

    fn center(&self, index: usize) -> DVec2 {
        let (x, y) = (index % self.count[0], index / self.count[0]);
        self.min + self.cell * DVec2::new(x as f64 + 0.5, y as f64 + 0.5)
    }

    fn index(&self, p: DVec2) -> Option<usize> {
        let u = (p - self.min) / self.cell;
        let inside = u.min_element() >= 0.0 && u.x < self.count[0] as f64 && u.y < self.count[1] as f64;
        inside.then(|| u.y as usize * self.count[0] + u.x as usize)
    }

    fn neighbours(&self, index: usize) -> impl Iterator<Item = usize> {
        let [nx, ny] = self.count;
        let (x, y) = (index % nx, index / nx);
        [
            (x > 0).then(|| index - 1),
            (x + 1 < nx).then(|| index + 1),
            (y > 0).then(|| index - nx),
            (y + 1 < ny).then(|| index + nx),
        ]
        .into_iter()
        .flatten()
    }
}

/// The topmost surface in a cell.
#[derive(Debug, Clone, Copy)]
struct Seen {
    height: f64,
    level: bool,
    body: usize,
}

/// A connected level surface of one body.
struct Patch {
    body: usize,
    cells: Vec<usize>,
}

/// Returns the height of the scene's floor, metres; 0 without one.
fn floor_height(scene: &Scene) -> f64 {
    let floors = scene.bodies.iter().filter(|b| matches!(b.shape, BodyShape::HalfSpace));
    floors
        .map(|b| b.x_wb.translation.z)
        .fold(None, |a: Option<f64>, z| Some(a.map_or(z, |a| a.max(z))))
        .unwrap_or(0.0)
}

impl LandingSurface {
    /// Finds the task's surface: the largest level surface that is high enough and on which the vehicle fits.
    pub(crate) fn find(task: &LandingTask, vehicle: &Quadrotor, scene: &Scene) -> Result<Self, LandingError> {
        let wanted = wanted_body(task, scene)?;
        let surfaces = wash_surfaces(scene)?;
        let (grid, seen) = look_down(scene, &surfaces, &task.surface);
        let patches = patches(&grid, &seen, wanted, floor_height(scene) + task.surface.height_m);
        if patches.is_empty() {
            return Err(no_surface(task, scene, &grid, &seen));
        }
        let mut best: Option<(Self, usize)> = None;
        for patch in &patches {
            let fits = fits(&grid, &seen, patch, vehicle);
            let found = fits.iter().filter(|f| **f).count();
            if found > 0 && best.as_ref().is_none_or(|(_, area)| patch.cells.len() > *area) {
                best = Some((Self::of(scene, grid, &seen, patch, fits), patch.cells.len()));
            }
        }
        best.map(|(surface, _)| surface).ok_or_else(|| too_narrow(task, vehicle, scene, &grid, &patches))
    }

    fn of(scene: &Scene, grid: Grid, seen: &[Option<Seen>], patch: &Patch, fits: Vec<bool>) -> Self {
        let along = long_axis(&grid, &patch.cells);
        let allowed: Vec<DVec2> = (0..fits.len()).filter(|i| fits[*i]).map(|i| grid.center(i)).collect();
        let (low, high) = extent_along(along, allowed.iter().copied());
        let turn = DMat2::from_cols(along, along.perp());
        let all = extent_along(along, patch.cells.iter().map(|i| grid.center(*i)));
        let (l, h) = (all.0 - 0.5 * grid.cell, all.1 + 0.5 * grid.cell);
        let corner = |x: f64, y: f64| (turn * DVec2::new(x, y)).to_array();
        Self {
            body: scene.bodies[patch.body].name.clone(),
            top_w: median_height(seen, &patch.cells),
            area_m2: patch.cells.len() as f64 * grid.cell * grid.cell,
            center_w: (turn * (0.5 * (low + high))).to_array(),
            along_w: along.to_array(),
            half: (0.5 * (high - low)).to_array(),
            outline_w: [corner(l.x, l.y), corner(h.x, l.y), corner(h.x, h.y), corner(l.x, h.y)],
            grid,
            fits,
        }
    }

    /// Returns the point of the rectangle at `u` in [0, 1]², world x and y, metres.
    pub fn point(&self, u: [f64; 2]) -> DVec2 {
        let along = DVec2::from(self.along_w);
        let offset = |i: usize| (2.0 * u[i] - 1.0) * self.half[i];
        DVec2::from(self.center_w) + along * offset(0) + along.perp() * offset(1)
    }

    /// Inverts [`LandingSurface::point`], clamped to the rectangle.
    pub fn unit(&self, p_w: DVec2) -> [f64; 2] {
        let along = DVec2::from(self.along_w);
        let d = p_w - DVec2::from(self.center_w);
        let part = |v: f64, half: f64| {
            if half > 0.0 { (0.5 + 0.5 * v / half).clamp(0.0, 1.0) } else { 0.5 }
        };
        [part(d.dot(along), self.half[0]), part(d.dot(along.perp()), self.half[1])]
    }

    /// Returns whether the vehicle fits with its axis at this point: all feet on the surface, body and propellers free
    /// of obstacles.
    pub fn fits(&self, p_w: DVec2) -> bool {
        self.grid.index(p_w).and_then(|i| self.fits.get(i)).copied().unwrap_or(false)
    }

    /// Iterates over the points of the grid at which the vehicle fits, row by row, world x and y, metres.
    pub fn places(&self) -> impl Iterator<Item = DVec2> + '_ {
        (0..self.fits.len()).filter(|i| self.fits[*i]).map(|i| self.grid.center(i))
    }
}

/// Returns the index of the platform that the task names.
fn wanted_body(task: &LandingTask, scene: &Scene) -> Result<Option<usize>, LandingError> {
    if task.chooses_platform() {
        return Ok(None);
    }
    body_index(task, scene, "platform", &task.platform).map(Some)
}

/// Returns the index of a body that the task names.
pub(crate) fn body_index(
    task: &LandingTask,
    scene: &Scene,
    key: &str,
    name: &str,
) -> Result<usize, LandingError> {
    scene.body_index(name).ok_or_else(|| {
        let known: Vec<&str> = scene.bodies.iter().map(|b| b.name.as_str()).collect();
        LandingError::UnknownBody(InputError::new(
            format!("`{key}` names the body `{name}`, which scene `{}` does not have", scene.name),
            task.path(),
            format!("name one of its bodies ({}), or write \"auto\"", known.join(", ")),
        ))
    })
}

/// Computes the height map of all bodies except floors.
fn look_down(scene: &Scene, surfaces: &[BodySurface], limits: &SurfaceLimits) -> (Grid, Vec<Option<Seen>>) {
    let extents: Vec<Option<Aabb>> =
        scene.bodies.iter().zip(surfaces).map(|(b, s)| s.extent_w(&b.x_wb)).collect();
    let corners = extents.iter().flatten().flat_map(|e| [e.min, e.max]);
    let Some(around) = Aabb::of_points(corners) else {
        return (Grid::around(DVec2::ZERO, DVec2::ZERO), vec![None]);
    };
    let grid = Grid::around(around.min.truncate(), around.max.truncate());
    let poses_bw: Vec<DPose3> = scene.bodies.iter().map(|b| b.x_wb.inverse()).collect();
    let from = around.max.z + 0.1;
    let reach = from - around.min.z + 0.1;
    let least = limits.slope_rad.cos();
    let look = |cell: usize| {
        let p = grid.center(cell);
        let origin_w = p.extend(from);
        let mut best: Option<Seen> = None;
        for (body, extent) in extents.iter().enumerate() {
            let Some(e) = extent else { continue };
            if p.cmplt(e.min.truncate()).any() || p.cmpgt(e.max.truncate()).any() {
                continue;
            }
            let x_bw = &poses_bw[body];
            let direction_b = x_bw.rotation * DVec3::NEG_Z;
            if let Some(hit) = surfaces[body].ray(x_bw.transform_point(origin_w), direction_b, reach) {
                let height = from - hit.distance;
                if best.is_none_or(|b| height > b.height) {
                    let up = (scene.bodies[body].x_wb.rotation * hit.normal).z;
                    best = Some(Seen { height, level: up >= least, body });
                }
            }
        }
        best
    };
    (grid, (0..grid.len()).map(look).collect())
}

/// Returns the connected level surfaces above a height, of one body or of any, in the order of their first cells.
fn patches(grid: &Grid, seen: &[Option<Seen>], wanted: Option<usize>, least_height: f64) -> Vec<Patch> {
    let good = |i: usize| {
        seen[i].filter(|s| s.level && s.height >= least_height && wanted.is_none_or(|w| w == s.body))
    };
    let mut taken = vec![false; seen.len()];
    let mut patches = Vec::new();
    for first in 0..seen.len() {
        let Some(start) = good(first).filter(|_| !taken[first]) else { continue };
        taken[first] = true;
        let mut cells = vec![first];
        let mut next = 0;
        while next < cells.len() {
            let cell = cells[next];
            next += 1;
            let Some(here) = seen[cell] else { continue };
            for n in grid.neighbours(cell) {
                let joins = |s: &Seen| {
                    s.body == start.body && (s.height - here.height).abs() < STEP_M + 0.15 * grid.cell
                };
                if !taken[n] && good(n).is_some_and(|s| joins(&s)) {
                    taken[n] = true;
                    cells.push(n);
                }
            }
        }
        if cells.len() as f64 * grid.cell * grid.cell >= LEAST_AREA_M2 {
            patches.push(Patch { body: start.body, cells });
        }
    }
    patches
}

/// Computes for each cell whether the vehicle fits with its axis there.
fn fits(grid: &Grid, seen: &[Option<Seen>], patch: &Patch, vehicle: &Quadrotor) -> Vec<bool> {
    let mut is_patch = vec![false; seen.len()];
    patch.cells.iter().for_each(|&i| is_patch[i] = true);
    let stands = vehicle.standing_height();
    // Clearance above the surface: below the body's box, and below the propellers.
    let under_body = stands - vehicle.body_half.z;
    let under_propellers = stands + vehicle.rotors.iter().map(|r| r.z).fold(f64::INFINITY, f64::min);
    let reach = vehicle.reach();
    let cells = (reach / grid.cell).ceil() as i64;
    let around: Vec<(i64, i64, DVec2)> = (-cells..=cells)
        .flat_map(|y| (-cells..=cells).map(move |x| (x, y)))
        .map(|(x, y)| (x, y, DVec2::new(x as f64, y as f64) * grid.cell))
        .filter(|(_, _, d)| d.length() <= reach)
        .collect();
    let half = vehicle.body_half.truncate();
    let allowed = |index: usize| {
        let p = grid.center(index);
        let top = match seen[index] {
            // The axis must be above the patch, not above a gap in it.
            Some(s) if is_patch[index] => s.height,
            _ => return false,
        };
        let foot_half = vehicle.foot_half;
        let feet_stand = vehicle.feet.iter().all(|f| {
            let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
            corners.iter().all(|(x, y)| {
                grid.index(p + f.truncate() + foot_half * DVec2::new(*x, *y)).is_some_and(|i| is_patch[i])
            })
        });
        feet_stand
            && around.iter().all(|(x, y, d)| {
                let (cx, cy) = ((index % grid.count[0]) as i64 + x, (index / grid.count[0]) as i64 + y);
                if cx < 0 || cy < 0 || cx >= grid.count[0] as i64 || cy >= grid.count[1] as i64 {
                    return true;
                }
                let Some(s) = seen[cy as usize * grid.count[0] + cx as usize] else { return true };
                let free = if d.abs().cmple(half).all() { under_body } else { under_propellers };
                s.height - top < free
            })
    };
    (0..grid.len()).map(allowed).collect()
}

fn median_height(seen: &[Option<Seen>], cells: &[usize]) -> f64 {
    let mut heights: Vec<f64> = cells.iter().filter_map(|&i| Some(seen[i]?.height)).collect();
    quantile(&mut heights, 0.5, QuantileRule::Nearest).unwrap_or(f64::NAN)
}

/// Returns the direction of the largest spread of the cells, in the half plane x ≥ 0.
fn long_axis(grid: &Grid, cells: &[usize]) -> DVec2 {
    let n = cells.len() as f64;
    let mean: DVec2 = cells.iter().map(|&i| grid.center(i)).sum::<DVec2>() / n;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for &i in cells {
        let d = grid.center(i) - mean;
        (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
    }
    DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy))
}

/// Returns the smallest and largest coordinates of points along and across `along`.
fn extent_along(along: DVec2, points: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    let local = points.map(|p| DVec2::new(p.dot(along), p.dot(along.perp())));
    local.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)))
}

fn no_surface(task: &LandingTask, scene: &Scene, grid: &Grid, seen: &[Option<Seen>]) -> LandingError {
    let level = patches(grid, seen, None, f64::NEG_INFINITY);
    let highest =
        level.iter().map(|p| (median_height(seen, &p.cells), p.body)).max_by(|a, b| a.0.total_cmp(&b.0));
    let known = match highest {
        Some((height, body)) => format!(
            "its highest level surface is on `{}`, {:.2} m above the floor",
            scene.bodies[body].name,
            height - floor_height(scene)
        ),
        None => "none of its surfaces is level".to_owned(),
    };
    let of = if task.chooses_platform() { String::new() } else { format!(" of `{}`", task.platform) };
    LandingError::NoSurface(
        InputError::new(
            format!(
                "scene `{}` has no surface{of} to land on: none is level within {:.0}° and at least {:.2} m high",
                scene.name,
                task.surface.slope_rad.to_degrees(),
                task.surface.height_m
            ),
            task.path(),
            "name another `platform`, lower `surface.height_m`, or scan the landing surface from above",
        )
        .because(known),
    )
}

fn too_narrow(
    task: &LandingTask,
    vehicle: &Quadrotor,
    scene: &Scene,
    grid: &Grid,
    patches: &[Patch],
) -> LandingError {
    let feet = Aabb::of_points(vehicle.feet.iter().copied()).map_or(DVec3::ZERO, |b| b.extents());
    let needs = feet.truncate() + 2.0 * vehicle.foot_half;
    let largest = patches.iter().max_by_key(|p| p.cells.len());
    let has = largest.map_or(String::new(), |p| {
        let (low, high) = extent_along(long_axis(grid, &p.cells), p.cells.iter().map(|i| grid.center(*i)));
        let size = high - low + grid.cell;
        format!(
            "the largest one, on `{}`, is {:.2} m × {:.2} m, without the parts under other objects",
            scene.bodies[p.body].name, size.x, size.y
        )
    });
    LandingError::TooNarrow(
        InputError::new(
            format!(
                "the vehicle `{}` is wider than every surface that it could land on: its feet need {:.2} m × {:.2} m, and its \
                 propellers a circle of {:.2} m without obstacles",
                vehicle.name,
                needs.x,
                needs.y,
                2.0 * vehicle.reach()
            ),
            task.path(),
            "take a smaller `vehicle`, or name another `platform`",
        )
        .because(has),
    )
}
