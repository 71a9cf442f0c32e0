//! The entities stage: builds entities from a Gaussian model, its frames and its labels.

use crate::body;
use crate::cloud::{self, SurfaceDisc};
use crate::config::EntitiesConfig;
use crate::contact;
use crate::draft::{Draft, STAGE, SceneInputs};
use crate::environment;
use crate::fused::fused_surface;
use crate::level;
use crate::lid;
use crate::recognise::{recognise_sphere, sunk};
use crate::relabel::relabel;
use crate::stack;
use crate::statics::static_meshes;
use crate::support::{self, Carrier, RestingPlane, Surroundings};
use crate::underside::{return_sides, return_undersides};
use crate::views::Views;
use crate::{EntitiesError, EntitySet};
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{
    Aabb, BACKGROUND, CoreError, Entity, EntityKind, LabelInfo, Labels, MaskSource, Mesh, PointCloud, Seed,
    StageContext, Warnings,
};
use sms_frames::Sequence;
use sms_gaussians::GaussianModel;
use sms_mesh::{
    PointGrid,
    cloud::{chosen, extend, retain, thin},
    outline::{is_over, outline_on_plane},
    quantile,
};
use std::sync::atomic::{AtomicU64, Ordering};

/// Turns labelled Gaussians into bodies: one entity per label that was seen, and a static environment of all other
/// surface (paper, Section "Materialize").
///
/// # Errors
/// When labels and frames do not belong together, when a depth is invalid, and on interruption. Objects that cannot be
/// built are left out with a warning.
pub fn build_entities(
    model: &GaussianModel,
    sequence: &Sequence,
    labels: &Labels,
    config: &EntitiesConfig,
    context: StageContext<'_>,
) -> Result<EntitySet, EntitiesError> {
    let StageContext { progress, cancel, warnings, seed } = context;
    config.validate()?;
    check_inputs(sequence, labels)?;
    let views = Views::new(sequence, labels);
    let count = labels.objects.len() as u64;
    progress.begin("objects", 2 * count + 1);
    let mut around = support::surroundings(&views, 0.005);
    let discs_of = |label: u16| cloud::label_discs(model, &views, label, config);
    let ids = labels.objects.par_iter().map(|info| info.id);
    let (unlabelled, discs): (Vec<SurfaceDisc>, Vec<Vec<SurfaceDisc>>) =
        rayon::join(|| discs_of(sms_core::BACKGROUND), || ids.map(discs_of).collect());
    around.collect_lost_sides(&unlabelled);
    for (info, discs) in labels.objects.iter().zip(&discs) {
        around.collect_own_sides(info.id, discs);
    }
    let support_height = support::support_height(&around);
    let scene = SceneInputs { views: &views, around: &around, support_height, config };
    // Objects are built in parallel; warnings are sorted when they are written.
    let done = AtomicU64::new(0);
    let drafts: Vec<Option<Draft>> = labels
        .objects
        .par_iter()
        .zip(discs)
        .map(|(info, discs)| {
            cancel.check()?;
            let object_seed = seed.derive_index("object", u64::from(info.id));
            let draft = draft(discs, info, scene, object_seed, warnings);
            progress.update(done.fetch_add(1, Ordering::Relaxed) + 1, &info.name);
            Ok(draft)
        })
        .collect::<Result<_, CoreError>>()?;
    let mut drafts: Vec<Draft> = drafts.into_iter().flatten().collect();
    let mut joined = Vec::new();
    if labels.source == MaskSource::Geometry {
        joined = join_pieces(&mut drafts, scene, seed, warnings);
        fix_floating(&mut drafts, &around, warnings);
    }
    return_sides(&mut drafts);
    return_undersides(&mut drafts);
    let mut own_labels;
    let views = if joined.is_empty() {
        views
    } else {
        own_labels = labels.clone();
        relabel(&mut own_labels, &joined);
        views.relabelled(&own_labels)
    };
    done.store(count, Ordering::Relaxed);
    let entities: Vec<Option<Entity>> = drafts
        .par_iter()
        .map(|draft| {
            cancel.check()?;
            let entity = match draft.sphere {
                Some(fit) => Some(body::sphere_entity(draft, &fit)),
                None => {
                    let object_seed = seed.derive_index("solid", u64::from(draft.info.id));
                    body::mesh_entity(draft, &views, config, object_seed, warnings)
                }
            };
            progress.update(done.fetch_add(1, Ordering::Relaxed) + 1, &draft.info.name);
            Ok(entity)
        })
        .collect::<Result<_, CoreError>>()?;
    let mut entities: Vec<Entity> = entities.into_iter().flatten().collect();
    let rests: Vec<(u16, RestingPlane)> = drafts.iter().map(|d| (d.info.id, d.rest)).collect();
    // Before movable objects are parted from others: fixed ones have no volume that these could overlap.
    let mut environment = None;
    if config.environment.enabled || entities.iter().any(|e| e.kind == EntityKind::Static) {
        progress.update(2 * count, "static surface");
        let scene = SceneInputs { views: &views, around: &around, support_height, config };
        let fused = fused_surface(&views, &config.environment, seed.derive("surface"), cancel)?;
        let mut meshes = static_meshes(scene, &entities, &rests, &fused);
        environment = meshes.remove(&BACKGROUND).filter(|_| config.environment.enabled);
        for entity in entities.iter_mut().filter(|e| e.kind == EntityKind::Static) {
            if let Some(mesh) = meshes.remove(&entity.label) {
                body::keep_surface(entity, mesh, config.environment.spacing);
            } else if let Some((_, rest)) = rests.iter().find(|r| r.0 == entity.label) {
                body::add_parts(entity, &rest.plane, config);
            }
        }
    }
    let solid = |e: &Entity| e.parts.iter().map(Mesh::volume).sum::<f64>();
    let before: Vec<f64> = entities.iter().map(solid).collect();
    let floor = support_height.unwrap_or(0.0);
    let faces = level::level_faces(&mut entities, &rests, floor, config.convex.max_vertices);
    for overlap in contact::part_objects(&mut entities, &faces, config.convex.max_vertices, 0.003) {
        let (a, b) = (&entities[overlap.first].name, &entities[overlap.second].name);
        let fate = if overlap.left > 0.001 {
            format!("{:.1} mm of it are left", 1e3 * overlap.left)
        } else {
            "they were parted".to_owned()
        };
        let message = format!("`{a}` and `{b}` overlapped by {:.1} mm; {fate}", 1e3 * overlap.depth);
        warnings.add(STAGE, "objects_overlap", message, "check the masks where the two meet");
    }
    stack::close_gaps(&mut entities, floor, config.convex.max_vertices);
    lid::add_lids(&mut entities, &rests, floor, config.convex.max_vertices, &around);
    for (entity, before) in entities.iter().zip(before) {
        let lost = 1.0 - solid(entity) / before;
        if lost > 0.1 {
            let message = format!(
                "`{}` lost {:.0} % of its collision shape where others overlap it; its mass is that of the whole",
                entity.name,
                100.0 * lost
            );
            warnings.add(STAGE, "collision_shape_cut", message, "check the masks where they meet");
        }
    }
    if let Some(mesh) = environment {
        around.relabel(&joined);
        entities.push(environment::environment_entity(mesh, &around, &entities, &config.environment));
    }
    progress.end(&format!("{} entities", entities.len()));
    Ok(EntitySet { entities, support_height, joined })
}

fn check_inputs(sequence: &Sequence, labels: &Labels) -> Result<(), EntitiesError> {
    if sequence.is_empty() {
        return Err(EntitiesError::NoFrames);
    }
    if labels.maps.len() != sequence.len() {
        return Err(EntitiesError::LabelMapCount { maps: labels.maps.len(), frames: sequence.len() });
    }
    for (frame, map) in sequence.frames.iter().zip(&labels.maps) {
        let (index, map, depth) = (frame.index, map.size(), frame.depth.size());
        if map != depth {
            return Err(EntitiesError::LabelMapSize { frame: index, map, depth });
        }
        if let Some(&depth) = frame.depth.data.iter().find(|z| !(z.is_finite() && **z >= 0.0)) {
            return Err(EntitiesError::InvalidDepth { frame: index, depth });
        }
    }
    Ok(())
}

/// Smallest number of discs that describe a shape.
const FEW_DISCS: usize = 40;

fn draft(
    mut discs: Vec<SurfaceDisc>,
    info: &LabelInfo,
    scene: SceneInputs<'_>,
    seed: Seed,
    warnings: &Warnings,
) -> Option<Draft> {
    let SceneInputs { views, around, support_height, config } = scene;
    let name = &info.name;
    let coarse = cloud::coarse_spacing(config);
    if discs.len() < FEW_DISCS {
        let from_model = discs.len();
        discs = cloud::pixel_discs(views, info.id, coarse);
        if discs.len() >= FEW_DISCS {
            let message =
                format!("`{name}` has only {from_model} Gaussians; its surface comes from its depth pixels");
            warnings.add(STAGE, "few_gaussians", message, "train longer, or check its masks");
        }
    }
    let discs = cloud::drop_islands(discs, coarse);
    let spacing = cloud::spacing(&discs, views, info.id, config, seed.derive("spacing"));
    let mut cloud = cloud::densify(&discs, views, info.id, spacing, config, seed);
    let seen = cloud.points_w.len();
    if seen < 20 {
        let message = format!("`{name}` was hardly seen ({seen} surface points) and is left out");
        warnings.add(STAGE, "object_not_seen", message, "scan it from nearer or from more sides");
        return None;
    }
    let sparse = thin(&cloud.points_w, &cloud.normals_w, 0.8 * coarse);
    let sparse: Vec<DVec3> = sparse.into_iter().map(|i| cloud.points_w[i]).collect();
    // Discs can reach centimetres beyond the seen surface, below the foot. Such points are not part of the object.
    let outside: Vec<DVec3> = sparse.iter().copied().filter(|&p| !views.is_inside(p, info.id)).collect();
    let sparse = if 2 * outside.len() < sparse.len() { sparse } else { outside };
    let rest = support::find_rest(&sparse, info.id, around, support_height, seed);
    if rest.carrier == Carrier::Unseen {
        let message =
            format!("no surface was seen below `{name}`: a level one under its lowest point is assumed");
        warnings.add(STAGE, "support_not_seen", message, "scan the surface around it");
    }
    let below = drop_carrier_points(&mut cloud, &rest);
    let sphere = recognise_sphere(&cloud, info.id, &rest, scene, seed);
    Some(Draft { info: info.clone(), cloud, below, spacing, rest, sphere, fixed: false })
}

/// Joins pieces that a mask separated from their object: pieces that touch another object but could not stay in place
/// alone (a head on a statue, a nose on a bear). Stacked objects stay apart. Used only for masks from geometry: masks
/// from people and networks are trusted. Returns the labels of each piece and its host.
fn join_pieces(
    drafts: &mut Vec<Draft>,
    scene: SceneInputs<'_>,
    seed: Seed,
    warnings: &Warnings,
) -> Vec<(u16, u16)> {
    let SceneInputs { around, config, .. } = scene;
    let mut joined = Vec::new();
    let reach = 2.0 * cloud::coarse_spacing(config);
    let mut i = 0;
    while i < drafts.len() {
        let points = &drafts[i].cloud.points_w;
        let bounds = Aabb::of_points(points.iter().copied());
        let touches = |j: &usize| {
            let others = &drafts[*j].cloud.points_w;
            let (Some(a), Some(b)) = (bounds, Aabb::of_points(others.iter().copied())) else { return false };
            if *j == i || (a.min - reach).cmpgt(b.max).any() || (b.min - reach).cmpgt(a.max).any() {
                return false;
            }
            let grid = PointGrid::new(others, reach);
            let stride = points.len().div_ceil(2000).max(1);
            let near = points.iter().step_by(stride).filter(|&&p| grid.is_near(p, reach)).count();
            20 * near >= points.len().div_ceil(stride)
        };
        let size = |j: usize| drafts[j].cloud.points_w.len();
        let host = (0..drafts.len()).filter(touches).max_by_key(|&j| size(j)).filter(|&j| {
            let carried = matches!(drafts[i].rest.carrier, Carrier::Object(_) | Carrier::Unseen);
            !can_stay(i, drafts, around)
                || (carried && !is_cradled(i, drafts, around) && 4 * points.len() < size(j))
        });
        let Some(host) = host else {
            i += 1;
            continue;
        };
        let piece = drafts.remove(i);
        let host = &mut drafts[if host > i { host - 1 } else { host }];
        joined.push((piece.info.id, host.info.id));
        extend(&mut host.cloud, piece.cloud);
        host.spacing = host.spacing.max(piece.spacing);
        host.sphere = recognise_sphere(&host.cloud, host.info.id, &host.rest, scene, seed);
        let (name, host) = (&piece.info.name, &host.info.name);
        let message = format!("`{name}` cannot stand by itself and touches `{host}`: they were joined");
        warnings.add(STAGE, "pieces_joined", message, "correct the masks if they are two things");
        // The host may be stable now, or touch another object: start over.
        i = 0;
    }
    joined
}

/// Turns objects without support into static colliders. Such an object is part of something larger that was not seen
/// whole (a shelf, a cable, a card stuck to a wall).
fn fix_floating(drafts: &mut [Draft], around: &Surroundings, warnings: &Warnings) {
    for i in 0..drafts.len() {
        if can_stay(i, drafts, around) {
            continue;
        }
        drafts[i].fixed = true;
        let name = &drafts[i].info.name;
        let message = format!("nothing that carries `{name}` was seen: it is kept as a fixed collider");
        warnings.add(STAGE, "kept_fixed", message, "scan the surface around it, or correct the masks");
    }
}

/// Returns whether an object would stay in place: it stands on the floor or the environment, it lies flat on another
/// object with its centre above the contact, or it is a ball in a hollow of that object.
fn can_stay(i: usize, drafts: &[Draft], around: &Surroundings) -> bool {
    let draft = &drafts[i];
    let plane = &draft.rest.plane;
    let points = &draft.cloud.points_w;
    let heights: Vec<f64> = points.iter().map(|&p| plane.height(p)).collect();
    let seen = quantile(heights.clone(), 0.02);
    // The foot itself is often hidden. The lowest point of a ball follows from the fit; other shapes get a tolerance of
    // a tenth.
    let lowest = draft.sphere.map_or(seen, |fit| plane.height(fit.center) - fit.radius);
    let slack = (0.1 * (quantile(heights, 0.98) - seen)).max(0.015);
    match draft.rest.carrier {
        Carrier::Unseen => false,
        Carrier::Floor | Carrier::Environment => lowest < slack,
        Carrier::Object(_) if draft.sphere.is_some() => is_cradled(i, drafts, around),
        Carrier::Object(_) => {
            let middle = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
            let foot = outline_on_plane(points, plane, 0.01, 0.0);
            lowest < 0.01 && foot.len() >= 3 && is_over(&foot, plane, middle)
        }
    }
}

/// Returns whether a ball lies in a hollow of its carrier, or on a level part that extends on all sides. The carrier's
/// surface is seen around the ball's foot in every direction and nowhere falls away below it (as it does below the head
/// of a statue).
fn is_cradled(i: usize, drafts: &[Draft], around: &Surroundings) -> bool {
    let (Some(fit), Carrier::Object(label)) = (drafts[i].sphere, drafts[i].rest.carrier) else {
        return false;
    };
    let Some(carrier) = drafts.iter().find(|d| d.info.id == label) else { return false };
    // Noise of the surface and of the fit's lowest point.
    let give = (0.1 * fit.radius).max(0.003);
    if sunk(&fit, around, &drafts[i].rest) > give {
        return false;
    }
    let mut highest = [f64::NEG_INFINITY; support::SECTORS];
    for p in &carrier.cloud.points_w {
        let from = p - fit.center;
        let out = from.truncate().length();
        if out > 0.3 * fit.radius && out < 1.5 * fit.radius && from.z < 0.0 {
            let here = &mut highest[support::sector(from)];
            *here = here.max(from.z);
        }
    }
    highest.iter().all(|&z| z > -fit.radius - give)
}

/// Removes points on and below the carrying plane, where labels bleed around an object's foot. The band is not wider
/// than the plane's scatter, because the floor of a thin dish lies just above the plane. Returns the points below.
fn drop_carrier_points(cloud: &mut PointCloud, rest: &RestingPlane) -> PointCloud {
    const BELOW_M: f64 = -0.003;
    let heights: Vec<f64> = cloud.points_w.iter().map(|&p| rest.plane.height(p)).collect();
    let top = heights.iter().copied().fold(0.0, f64::max);
    // The top of a thin object may also be this close to the plane.
    let band = (0.15 * top).min((4.0 * rest.noise_m).clamp(0.0008, 0.003));
    let is_own = |(h, n): (&f64, &DVec3)| *h > BELOW_M && !(*h < band && n.dot(rest.plane.normal) > 0.8);
    let keep: Vec<bool> = heights.iter().zip(&cloud.normals_w).map(is_own).collect();
    if keep.iter().filter(|&&k| k).count() < 20 {
        return PointCloud::default();
    }
    let below = chosen(cloud, &heights.iter().map(|h| *h <= BELOW_M).collect::<Vec<_>>());
    retain(cloud, &keep);
    below
}
