//! The stage: from a Gaussian model with its frames and labels to entities.

use crate::cloud::{self, Disc};
use crate::config::EntitiesConfig;
use crate::contact;
use crate::environment;
use crate::grid::{PointGrid, quantile};
use crate::mesher::{self, MeshInput, MeshPath};
use crate::sphere::{self, RaySample, SphereFit};
use crate::support::{self, Carrier, Rest, Surroundings};
use crate::underside::{contact_points, is_over, outline_on_plane};
use crate::views::{Views, depth_sigma, depth_tolerance};
use crate::{EntitiesError, EntitySet};
use glamx::DVec3;
use sms_core::{
    Cancel, Entity, EntityKind, EntityShape, LabelInfo, Labels, MaskSource, Mesh, PointCloud, Progress, Seed,
    Warnings,
};
use sms_frames::Sequence;
use sms_gaussians::GaussianModel;

const STAGE: &str = "materialize";

/// What is known of an object before it is meshed.
struct Draft {
    info: LabelInfo,
    cloud: PointCloud,
    rest: Rest,
    sphere: Option<SphereFit>,
    /// Whether it stays where it is: physics would drop what only seems to float.
    fixed: bool,
}

/// Turns labelled Gaussians into bodies: one dynamic entity per label that was seen, and a static environment of
/// everything that no label explains (paper, Section "Materialize").
///
/// # Errors
/// [`EntitiesError::Mismatch`] when labels and frames do not belong together, and on interruption. Objects that cannot
/// be built are left out with a warning.
pub fn build_entities(
    model: &GaussianModel,
    sequence: &Sequence,
    labels: &Labels,
    config: &EntitiesConfig,
    seed: Seed,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<EntitySet, EntitiesError> {
    config.validate()?;
    check_inputs(sequence, labels)?;
    let views = Views { sequence, labels };
    let spacing = cloud::spacing(config);
    let count = labels.objects.len() as u64;
    progress.begin("objects", 2 * count + 1);
    let around = support::surroundings(&views, 0.005);
    let support_height = support::support_height(&around);
    let mut drafts = Vec::new();
    for (i, info) in labels.objects.iter().enumerate() {
        cancel.check()?;
        progress.update(i as u64, &info.name);
        let object_seed = seed.derive_index("object", u64::from(info.id));
        drafts.extend(draft(model, &views, &around, support_height, info, config, object_seed, warnings));
    }
    if labels.source == MaskSource::Geometry {
        join_pieces(&mut drafts, &views, config, seed, warnings);
        fix_floating(&mut drafts, warnings);
    }
    let mut entities = Vec::new();
    for (i, draft) in drafts.iter().enumerate() {
        cancel.check()?;
        progress.update(count + i as u64, &draft.info.name);
        entities.extend(match draft.sphere {
            Some(fit) => Some(sphere_entity(draft, &fit)),
            None => mesh_entity(draft, &views, config, spacing, warnings),
        });
    }
    for overlap in contact::part_objects(&mut entities, config.convex.max_vertices, 0.003) {
        let (a, b) = (&entities[overlap.first].name, &entities[overlap.second].name);
        let message =
            format!("`{a}` and `{b}` overlapped by {:.1} mm; they were cut apart", 1e3 * overlap.depth);
        warnings.add(STAGE, "objects_overlap", message, "check the masks where the two meet");
    }
    cancel.check()?;
    if config.environment.enabled {
        progress.update(2 * count, "environment");
        let rests: Vec<(u16, Rest)> = drafts.iter().map(|d| (d.info.id, d.rest)).collect();
        entities.extend(environment::environment_entity(
            &views,
            &around,
            &entities,
            &rests,
            support_height,
            config,
        ));
    }
    progress.end(&format!("{} entities", entities.len()));
    Ok(EntitySet { entities, support_height })
}

fn check_inputs(sequence: &Sequence, labels: &Labels) -> Result<(), EntitiesError> {
    if sequence.is_empty() {
        return Err(EntitiesError::Mismatch("there are no frames to build objects from".into()));
    }
    if labels.maps.len() != sequence.len() {
        let message = format!(
            "there are {} label maps for {} frames; make the masks again for this recording",
            labels.maps.len(),
            sequence.len()
        );
        return Err(EntitiesError::Mismatch(message));
    }
    for (frame, map) in sequence.frames.iter().zip(&labels.maps) {
        if map.size() != frame.depth.size() {
            let message = format!(
                "label map {} is {}×{} but its frame is {}×{}; make the masks again at this size",
                frame.index, map.width, map.height, frame.depth.width, frame.depth.height
            );
            return Err(EntitiesError::Mismatch(message));
        }
    }
    Ok(())
}

/// Fewer discs than this are not enough to say anything about a shape.
const FEW_DISCS: usize = 40;

fn draft(
    model: &GaussianModel,
    views: &Views,
    around: &Surroundings,
    support_height: Option<f64>,
    info: &LabelInfo,
    config: &EntitiesConfig,
    seed: Seed,
    warnings: &Warnings,
) -> Option<Draft> {
    let spacing = cloud::spacing(config);
    let mut discs: Vec<Disc> = cloud::label_discs(model, views, info.id, config);
    if discs.len() < FEW_DISCS {
        let from_model = discs.len();
        discs = cloud::pixel_discs(views, info.id, spacing);
        if discs.len() >= FEW_DISCS {
            warnings.add(
                STAGE,
                "few_gaussians",
                format!(
                    "`{}` has only {from_model} Gaussians; its surface comes from its depth pixels",
                    info.name
                ),
                "train longer, or check its masks",
            );
        }
    }
    let discs = cloud::drop_islands(discs, spacing);
    let mut cloud = cloud::densify(&discs, views, info.id, config, seed);
    if cloud.points_w.len() < 20 {
        warnings.add(
            STAGE,
            "object_not_seen",
            format!(
                "`{}` was hardly seen ({} surface points) and is left out",
                info.name,
                cloud.points_w.len()
            ),
            "scan it from nearer or from more sides",
        );
        return None;
    }
    let rest = support::find_rest(&cloud.points_w, info.id, around, support_height, seed);
    if rest.carrier == Carrier::Unseen {
        warnings.add(
            STAGE,
            "support_not_seen",
            format!(
                "no surface was seen below `{}`: a level one under its lowest point is assumed",
                info.name
            ),
            "scan the surface around it",
        );
    }
    drop_carrier_points(&mut cloud, &rest);
    let sphere = recognise_sphere(&cloud, views, info.id, &rest, config, seed);
    Some(Draft { info: info.clone(), cloud, rest, sphere, fixed: false })
}

/// What touches another object but could not stay where it is by itself is a piece of that object that its mask
/// lost: a head on a statue, a nose on a bear. It is joined to it. What lies on another object (a stack) stays apart.
/// For masks from geometry only: those of people and networks mean what they say.
fn join_pieces(
    drafts: &mut Vec<Draft>,
    views: &Views,
    config: &EntitiesConfig,
    seed: Seed,
    warnings: &Warnings,
) {
    let reach = 2.0 * cloud::spacing(config);
    let mut i = 0;
    while i < drafts.len() {
        let points = &drafts[i].cloud.points_w;
        let touches = |j: &usize| {
            let grid = PointGrid::new(&drafts[*j].cloud.points_w, reach);
            let gaps = points.iter().filter_map(|&p| grid.nearest(p)).map(|n| n.0).collect();
            *j != i && quantile(gaps, 0.05) < reach
        };
        let size = |j: usize| drafts[j].cloud.points_w.len();
        let host = (0..drafts.len()).filter(touches).max_by_key(|&j| size(j)).filter(|&j| {
            let carried = matches!(drafts[i].rest.carrier, Carrier::Object(_) | Carrier::Unseen);
            !can_stay(&drafts[i]) || (carried && 4 * points.len() < size(j))
        });
        let Some(host) = host else {
            i += 1;
            continue;
        };
        let piece = drafts.remove(i);
        let host = &mut drafts[if host > i { host - 1 } else { host }];
        host.cloud.points_w.extend(piece.cloud.points_w);
        host.cloud.normals_w.extend(piece.cloud.normals_w);
        host.cloud.colors.extend(piece.cloud.colors);
        host.sphere = recognise_sphere(&host.cloud, views, host.info.id, &host.rest, config, seed);
        let message = format!(
            "`{}` cannot stand by itself and touches `{}`: they were joined",
            piece.info.name, host.info.name
        );
        warnings.add(STAGE, "pieces_joined", message, "correct the masks if they are two things");
        // The host may stand now, or have grown to touch another: look again from the start.
        i = 0;
    }
}

/// What is left without anything to stand on is part of something larger that was not seen whole (a shelf, a cable, a
/// card stuck to a wall): it becomes a fixed collider.
fn fix_floating(drafts: &mut [Draft], warnings: &Warnings) {
    for draft in drafts.iter_mut().filter(|d| !can_stay(d)) {
        draft.fixed = true;
        let message =
            format!("nothing that carries `{}` was seen: it is kept as a fixed collider", draft.info.name);
        let cure = "scan the surface around it, or correct the masks";
        warnings.add(STAGE, "kept_fixed", message, cure);
    }
}

fn kind(draft: &Draft) -> EntityKind {
    if draft.fixed { EntityKind::Static } else { EntityKind::Dynamic }
}

/// Whether an object would stay where it was seen: it stands on the floor or the environment, or it lies flat on
/// another object with its middle over the contact.
fn can_stay(draft: &Draft) -> bool {
    let plane = &draft.rest.plane;
    let points = &draft.cloud.points_w;
    let heights: Vec<f64> = points.iter().map(|&p| plane.height_over(p)).collect();
    let seen = quantile(heights.clone(), 0.02);
    // The foot itself is often hidden: a ball's lowest point follows from the fit, other shapes get a tenth.
    let lowest = draft.sphere.map_or(seen, |fit| plane.height_over(fit.center) - fit.radius);
    let slack = (0.1 * (quantile(heights, 0.98) - seen)).max(0.015);
    match draft.rest.carrier {
        Carrier::Unseen => false,
        Carrier::Floor | Carrier::Environment => lowest < slack,
        Carrier::Object(_) => {
            let middle = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
            let foot = outline_on_plane(points, plane, 0.01, 0.0);
            draft.sphere.is_none() && lowest < 0.01 && foot.len() >= 3 && is_over(&foot, plane, middle)
        }
    }
}

/// Labels bleed onto the carrying surface around an object's foot: points of the plane, and below it, are not its own.
fn drop_carrier_points(cloud: &mut PointCloud, rest: &Rest) {
    let top = cloud.points_w.iter().map(|&p| rest.plane.height_over(p)).fold(0.0, f64::max);
    // A thin object's top may be this near to the plane itself.
    let band = (0.15 * top).min(0.003);
    let keep: Vec<bool> = cloud
        .points_w
        .iter()
        .zip(&cloud.normals_w)
        .map(|(&p, n)| {
            let h = rest.plane.height_over(p);
            h > -0.003 && !(h < band && n.dot(rest.plane.normal) > 0.8)
        })
        .collect();
    if keep.iter().filter(|&&k| k).count() >= 20 {
        cloud::retain(cloud, &keep);
    }
}

/// Labelled depth pixels away from edges of depth and mask, as rays.
fn object_rays(views: &Views, label: u16) -> Vec<RaySample> {
    let mut rays = Vec::new();
    for (f, frame) in views.sequence.frames.iter().enumerate() {
        let map = &views.labels.maps[f];
        for y in 1..map.height.saturating_sub(1) {
            for x in 1..map.width.saturating_sub(1) {
                let depth = f64::from(frame.depth[(x, y)]);
                if map[(x, y)] != label || depth <= 0.0 {
                    continue;
                }
                let inner = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].iter().all(|&at| {
                    let next = f64::from(frame.depth[at]);
                    map[at] == label && (next <= 0.0 || (next - depth).abs() < 4.0 * depth_tolerance(depth))
                });
                if !inner {
                    continue;
                }
                let origin = frame.camera.center_w();
                let p = frame.camera.unproject_pixel(x, y, depth);
                let distance = p.distance(origin);
                rays.push(RaySample {
                    origin,
                    direction: (p - origin) / distance,
                    distance,
                    sigma: depth_sigma(depth) * distance / depth,
                });
            }
        }
    }
    let stride = rays.len().div_ceil(40_000).max(1);
    rays.into_iter().step_by(stride).collect()
}

fn recognise_sphere(
    cloud: &PointCloud,
    views: &Views,
    label: u16,
    rest: &Rest,
    config: &EntitiesConfig,
    seed: Seed,
) -> Option<SphereFit> {
    let points = &cloud.points_w;
    let first = sphere::fit_sphere(points, &config.sphere, seed)?;
    if !sphere::is_sphere(&first, points, &config.sphere) {
        return None;
    }
    // A ball that stands on the level floor touches it: that fixes what the hidden lower half leaves open.
    let gap = first.center.z - first.radius - rest.plane.offset;
    let floor = (rest.carrier == Carrier::Floor && gap.abs() < 0.004).then_some((rest.plane.offset, 0.0005));
    let rays = object_rays(views, label);
    let best = match sphere::refine_on_rays(&rays, first.center, first.radius, floor) {
        Some((center, radius)) => {
            let refined = sphere::describe(points, center, radius, first.sigma, &config.sphere);
            // The rays may hold what the mask bleeds over; the cloud decides whether they improved the fit.
            if refined.inlier_share + 0.05 >= first.inlier_share { refined } else { first }
        }
        None => first,
    };
    (!is_contradicted(&best, views, label, rest)).then_some(best)
}

/// Share of a sphere's seen directions through which cameras may look before it is no ball. Borders of masks and of
/// depth cost a few percent; a bowl, the cap of a sphere, is seen through over half of it.
const SEEN_THROUGH: f64 = 0.12;
/// How far a ball may reach below what it rests on, metres.
const SUNK_M: f64 = 0.003;

/// Whether the cameras or the floor contradict that a whole sphere is there. A round bowl's wall lies on a sphere, too.
fn is_contradicted(fit: &SphereFit, views: &Views, label: u16, rest: &Rest) -> bool {
    if rest.plane.height_over(fit.center) - fit.radius < -SUNK_M {
        return true;
    }
    let (mut seen, mut through) = (0, 0);
    for direction in sphere::directions(400) {
        // Slightly inside, so that noise of a true surface is not taken for emptiness.
        let count = views.count(fit.center + direction * (0.97 * fit.radius), label);
        if count.own + count.free >= 2 {
            seen += 1;
            through += usize::from(count.free > count.own);
        }
    }
    through as f64 > SEEN_THROUGH * f64::from(seen.max(1))
}

fn sphere_entity(draft: &Draft, fit: &SphereFit) -> Entity {
    let mut center_w = fit.center;
    if draft.rest.carrier != Carrier::Unseen {
        // No overlap and no gap with what carries it, where they are within what the scan can tell.
        let gap = draft.rest.plane.height_over(center_w) - fit.radius;
        if gap.abs() < 0.003 {
            center_w -= draft.rest.plane.normal * gap;
        }
    }
    let mut mesh = Mesh::icosphere(fit.radius, 3);
    for v in &mut mesh.vertices {
        *v += center_w;
    }
    let mean_color = cloud::mean_color(&draft.cloud.colors);
    mesh.colors = vec![mean_color; mesh.vertices.len()];
    let residuals = draft.cloud.points_w.iter().map(|p| (p.distance(center_w) - fit.radius).abs()).collect();
    Entity {
        label: draft.info.id,
        name: draft.info.name.clone(),
        description: draft.info.description.clone(),
        kind: kind(draft),
        shape: EntityShape::Sphere { center_w, radius: fit.radius },
        cloud: draft.cloud.clone(),
        mesh,
        parts: Vec::new(),
        texture: None,
        observed_share: fit.coverage,
        residual_m: crate::grid::median(residuals),
        mean_color,
    }
}

fn mesh_entity(
    draft: &Draft,
    views: &Views,
    config: &EntitiesConfig,
    spacing: f64,
    warnings: &Warnings,
) -> Option<Entity> {
    let name = &draft.info.name;
    let contact = contact_points(&draft.cloud, &draft.rest, views, draft.info.id, spacing);
    let input = MeshInput {
        cloud: &draft.cloud,
        contact: &contact,
        rest: draft.rest.plane,
        views: Some(views),
        spacing,
    };
    let Some((mut mesh, path)) = mesher::mesh_object(&input, config) else {
        warnings.add(
            STAGE,
            "object_flat",
            format!("the surface seen of `{name}` is flat: no solid can be made of it, and it is left out"),
            "scan it from more sides",
        );
        return None;
    };
    match path {
        MeshPath::Asked => {}
        MeshPath::Prune => warnings.add(
            STAGE,
            "mesh_rule_changed",
            format!("the chosen mesh rule left no solid of `{name}`; the other rule was used"),
            "scan it from more sides",
        ),
        MeshPath::Hull => warnings.add(
            STAGE,
            "mesh_is_hull",
            format!("`{name}` is represented by the convex hull of its points: its hollows are lost"),
            "scan it from more sides",
        ),
    }
    mesh.colors = crate::refine::colors_from(&draft.cloud.points_w, &draft.cloud.colors, &mesh, spacing);
    let mut parts = sms_convex::convex_parts(&mesh, &config.convex);
    crate::foot::keep_foot(&mut parts, &mesh, &draft.rest.plane, config.convex.max_vertices);
    let stride = draft.cloud.points_w.len().div_ceil(1500).max(1);
    let sample: Vec<DVec3> = draft.cloud.points_w.iter().copied().step_by(stride).collect();
    Some(Entity {
        label: draft.info.id,
        name: name.clone(),
        description: draft.info.description.clone(),
        kind: kind(draft),
        shape: EntityShape::Convex,
        cloud: draft.cloud.clone(),
        observed_share: mesher::observed_share(&mesh, &draft.cloud, 1.5 * spacing),
        residual_m: crate::grid::median(mesher::distances(&sample, &mesh)),
        mean_color: cloud::mean_color(&draft.cloud.colors),
        mesh,
        parts,
        texture: None,
    })
}
