//! The GPU's kernels compared with the CPU's and with the double-precision oracle, on any adapter (Mesa's lavapipe in
//! continuous integration). Without an adapter, the tests print a line and pass.

use crate::compare::{ErrorSpread, GROUPS, first_moments, images, relative};
use crate::oracle::Oracle;
use crate::probe::{BACKGROUND, CLASSES, camera, fill, frame, still};
use crate::{AdapterChoice, GpuTrainer, SelfCheck, adapters};
use sms_core::{Camera, Seed};
use sms_gaussians::parameters::Parameters;
use sms_gaussians::{
    CpuTrainer, DepthTerm, LearningRates, LossWeights, Seedling, StepBatch, TrainConfig, Trainer,
};

const SIZE: (usize, usize) = (61, 37);
const COUNT: usize = 150;
const SEED: Seed = Seed(2);
/// Kernels without guards.
const FAST: bool = false;
/// Guarded kernels.
const GUARDED: bool = true;

/// Returns the adapter to test, or `None` with a printed line. `SMS_TEST_ADAPTER` selects another adapter than the
/// first.
pub(crate) fn adapter() -> Option<AdapterChoice> {
    let index = std::env::var("SMS_TEST_ADAPTER").ok().and_then(|v| v.parse().ok()).unwrap_or(0);
    if index < adapters().len() {
        return Some(AdapterChoice::Index(index));
    }
    println!("skipped: there is no adapter {index} (install mesa-vulkan-drivers for a software one)");
    None
}

fn gpu(config: &TrainConfig, guarded: bool) -> Option<GpuTrainer> {
    let made = GpuTrainer::with_kernels(config, CLASSES, SEED, adapter()?, guarded);
    Some(made.unwrap_or_else(|e| panic!("{e}")))
}

fn filled_pair(config: &TrainConfig, guarded: bool) -> Option<(CpuTrainer, GpuTrainer)> {
    let (mut cpu, mut gpu) = (CpuTrainer::new(config, CLASSES, SEED), gpu(config, guarded)?);
    fill(&mut cpu, SIZE, COUNT);
    fill(&mut gpu, SIZE, COUNT);
    Some((cpu, gpu))
}

fn oracle(cpu: &CpuTrainer, config: &TrainConfig) -> Oracle {
    let parameters = Parameters::decode(&cpu.snapshot()).unwrap();
    Oracle { background: BACKGROUND.map(f64::from), ..Oracle::new(&parameters, config, true) }
}

#[test]
fn images_equal_the_cpu_and_the_oracle() {
    let Some((mut cpu, mut gpu)) = filled_pair(&TrainConfig::default(), FAST) else {
        return;
    };
    let camera = camera(SIZE);
    let (a, b) = (gpu.render(&camera), cpu.render(&camera));
    assert_eq!(gpu.failure(), None);
    let spread = images(&a, &b);
    println!("{}: image against the CPU {spread}", gpu.adapter().name);
    assert!(spread.p999 <= 1e-5 && spread.max < 5e-3, "{spread}");
    let truth = oracle(&cpu, &TrainConfig::default()).render(&camera);
    let channels = a.color.iter().zip(&a.normal_w).zip(&a.alpha).zip(&truth.pixels);
    let spread = ErrorSpread::of(channels.flat_map(|(((color, normal), alpha), truth)| {
        let all = [color[0], color[1], color[2], normal[0], normal[1], normal[2], *alpha].map(f64::from);
        let truth = [truth[0], truth[1], truth[2], truth[3], truth[4], truth[5], truth[23]];
        std::array::from_fn::<f64, 7, _>(|k| all[k] - truth[k])
    }));
    println!("{}: image against the oracle {spread}", gpu.adapter().name);
    assert!(spread.p999 <= 1e-5 && spread.max < 5e-3, "{spread}");
    // The median jumps from one splat to the next; a rounding error near one half may select another.
    let other_depth = a.depth.iter().zip(&b.depth).filter(|(a, b)| (**a - **b).abs() > 1e-4).count();
    let other_label = a.label.iter().zip(&b.label).filter(|(a, b)| a != b).count();
    println!("pixels with another median depth {other_depth}, another label {other_label}");
    assert!(other_depth <= 3 && other_label <= 3, "{other_depth} depths, {other_label} labels");
    assert!(b.depth.iter().filter(|z| **z > 0.0).count() > SIZE.0 * SIZE.1 / 2, "depths were compared");
}

/// Settings that train view-dependent colour too, and hold discs in their planes.
fn directed() -> TrainConfig {
    let rates = LearningRates { harmonics: 2e-3, off_plane: 0.3, ..LearningRates::default() };
    TrainConfig { rates, ..TrainConfig::default() }
}

/// Gradients of one step: Adam's first moments after a step with rates that move nothing.
fn compare_gradients(config: &TrainConfig, guarded: bool) -> Option<f64> {
    let config = TrainConfig { rates: still(), ..*config };
    let (mut cpu, mut gpu) = filled_pair(&config, guarded)?;
    let oracle = oracle(&cpu, &config);
    let (a, b) = (gpu.steps(&[0]), cpu.steps(&[0]));
    assert_eq!(gpu.failure(), None);
    let terms = [
        (a.loss.color_l1, b.loss.color_l1),
        (a.loss.dssim, if config.weights.color * config.weights.ssim > 0.0 { b.loss.dssim } else { 0.0 }),
        (a.loss.isotropic, b.loss.isotropic),
        (a.loss.depth, b.loss.depth),
        (a.loss.normal, b.loss.normal),
        (a.loss.flat, b.loss.flat),
        (a.loss.segmentation, b.loss.segmentation),
        (a.loss.total, b.loss.total),
    ];
    for (k, (a, b)) in terms.into_iter().enumerate() {
        assert!((a - b).abs() <= 2e-5 * (1.0 + b.abs()), "term {k}: {a} and {b}");
    }
    let (state, reference) = (gpu.snapshot(), cpu.snapshot());
    let mut worst = 0.0f64;
    for (name, spread) in first_moments(&state, &reference).unwrap() {
        println!("  {name}: against the CPU {spread}");
        assert!(spread.p999 <= 1e-3 && spread.max <= 1e-2, "{name}: {spread}");
        worst = worst.max(spread.max);
    }
    if config.segmentation_share < 1.0 {
        return Some(worst);
    }
    let truth = oracle.gradient(&frame(&camera(SIZE), Seed(4)));
    let state = Parameters::decode(&state).unwrap();
    for (name, first, end) in GROUPS {
        // Adam's first moment after one step is a tenth of the gradient.
        let ours: Vec<f64> =
            state.first.iter().flat_map(|r| r.0[first..end].iter().map(|v| 10.0 * f64::from(*v))).collect();
        let truth: Vec<f64> = truth.rows.iter().flat_map(|r| r[first..end].to_vec()).collect();
        let spread = relative(&ours, &truth);
        println!("  {name}: against the oracle {spread}");
        assert!(spread.p999 <= 1e-3 && spread.max <= 1e-2, "{name}: {spread}");
        worst = worst.max(spread.max);
    }
    Some(worst)
}

#[test]
fn gradients_equal_the_cpu_and_the_oracle() {
    let none = LossWeights {
        color: 0.0,
        ssim: 0.0,
        isotropic: 0.0,
        depth: 0.0,
        normal: 0.0,
        flat: 0.0,
        segmentation: 0.0,
    };
    let only = |weights: LossWeights| TrainConfig { weights, ..TrainConfig::default() };
    let depth_in = |depth_term| TrainConfig { depth_term, ..only(LossWeights { depth: 1.0, ..none }) };
    let configs = [
        ("all", TrainConfig::default()),
        ("no flatness", only(LossWeights { flat: 0.0, isotropic: 10.0, ..LossWeights::default() })),
        ("colour", only(LossWeights { color: 1.0, ..none })),
        ("SSIM", only(LossWeights { color: 1.0, ssim: 1.0, ..none })),
        ("depth", depth_in(DepthTerm::Normalized)),
        ("accumulated depth", depth_in(DepthTerm::Accumulated)),
        ("detached depth", depth_in(DepthTerm::Detached)),
        ("normals", only(LossWeights { normal: 1.0, ..none })),
        ("isotropy", only(LossWeights { isotropic: 1.0, ..none })),
        ("flatness", only(LossWeights { flat: 1.0, ..none })),
        ("segmentation", only(LossWeights { segmentation: 1.0, ..none })),
        ("a share of the pixels", TrainConfig { segmentation_share: 0.4, ..TrainConfig::default() }),
    ];
    for (name, config) in configs {
        println!("{name}");
        if compare_gradients(&config, FAST).is_none() {
            return;
        }
    }
}

#[test]
fn with_guards_the_gradients_are_the_same() {
    compare_gradients(&TrainConfig::default(), GUARDED);
}

#[test]
fn loss_curves_follow_the_cpu() {
    let Some((mut cpu, mut gpu)) = filled_pair(&TrainConfig::default(), FAST) else {
        return;
    };
    let mut worst = 0.0f32;
    for step in 0..50 {
        let (a, b) = (gpu.steps(&[step % 2]).loss.total, cpu.steps(&[step % 2]).loss.total);
        worst = worst.max((a / b - 1.0).abs());
    }
    println!("50 steps: largest difference of the loss {:.4} %", 100.0 * worst);
    assert!(worst <= 0.01, "{worst}");
}

#[test]
fn one_submission_of_many_steps_is_many_submissions_of_one() {
    let Some(mut one) = gpu(&TrainConfig::default(), FAST) else {
        return;
    };
    let Some(mut many) = gpu(&TrainConfig::default(), FAST) else {
        return;
    };
    // More steps than one submission holds.
    let (size, count) = ((31, 19), 40);
    fill(&mut one, size, count);
    fill(&mut many, size, count);
    let frames: Vec<usize> = (0..70).map(|i| i % 2).collect();
    let stats = one.steps(&frames);
    let total: f64 = frames.iter().map(|&f| f64::from(many.steps(&[f]).loss.total)).sum();
    assert_eq!(stats.steps, 70);
    assert!((f64::from(stats.loss.total) - total / 70.0).abs() < 1e-5 * total / 70.0);
    assert_eq!(one.snapshot(), many.snapshot(), "the same bytes, in whatever order workgroups ran");
}

#[test]
fn batches_together_are_batches_one_by_one_and_a_frame_is_added_meanwhile() {
    let (Some(mut together), Some(mut apart)) =
        (gpu(&TrainConfig::default(), FAST), gpu(&TrainConfig::default(), FAST))
    else {
        return;
    };
    fill(&mut together, SIZE, COUNT);
    fill(&mut apart, SIZE, COUNT);
    let batch = |i: i32| StepBatch {
        rates: LearningRates::default().scaled(0.5f32.powi(i)),
        own: vec![0; 5],
        replayed: vec![1; 3],
    };
    let batches: Vec<StepBatch> = (0..3).map(batch).collect();
    let another = || frame(&camera(SIZE), Seed(6));
    let (stats, added) = together.batches(&batches, &|| Some(another()));
    let one_by_one = batches.iter().map(|batch| {
        apart.set_rates(&batch.rates);
        let own = apart.steps(&batch.own);
        apart.steps(&batch.replayed);
        own
    });
    assert_eq!(stats, one_by_one.collect::<Vec<_>>());
    assert_eq!(together.snapshot(), apart.snapshot());
    assert_eq!((added, apart.add_frame(another())), (Some(2), 2));
    assert_eq!(together.steps(&[2]), apart.steps(&[2]));
}

#[test]
fn a_state_continues_on_the_other_back_end() {
    let Some((mut cpu, mut gpu)) = filled_pair(&directed(), FAST) else {
        return;
    };
    cpu.steps(&[0, 1, 0]);
    let state = cpu.snapshot();
    gpu.restore(&state).unwrap();
    assert_eq!(gpu.snapshot(), state, "a state goes through the device unchanged");
    assert_eq!(gpu.len(), cpu.len());
    // Three steps on the other back end; the classifier's count continues.
    let (a, b) = (gpu.steps(&[1, 0, 1]).loss.total, cpu.steps(&[1, 0, 1]).loss.total);
    assert!((a / b - 1.0).abs() < 1e-4, "{a} {b}");
    let (ours, theirs) = (gpu.snapshot(), cpu.snapshot());
    let (ours_p, theirs_p) = (Parameters::decode(&ours).unwrap(), Parameters::decode(&theirs).unwrap());
    assert_eq!(ours_p.steps, theirs_p.steps);
    assert_eq!(ours_p.classifier.steps, 6);
    cpu.restore(&ours).unwrap();
    assert_eq!(cpu.snapshot(), ours);
    let mut other = CpuTrainer::new(&TrainConfig::default(), CLASSES + 1, SEED);
    fill(&mut other, SIZE, 3);
    assert!(gpu.restore(&other.snapshot()).is_err(), "another number of classes");
    assert_eq!(gpu.snapshot(), ours, "a refused state changes nothing");
}

#[test]
fn gaussians_come_and_go_with_their_moments() {
    let Some((mut cpu, mut gpu)) = filled_pair(&directed(), FAST) else {
        return;
    };
    for trainer in [&mut cpu as &mut dyn Trainer, &mut gpu] {
        trainer.steps(&[0]);
    }
    gpu.restore(&cpu.snapshot()).unwrap();
    let mask: Vec<bool> = (0..COUNT).map(|i| i % 3 != 1).collect();
    let more = crate::probe::seedlings(&camera(SIZE), 40, Seed(9));
    for trainer in [&mut cpu as &mut dyn Trainer, &mut gpu] {
        trainer.retain(&mask);
        trainer.insert(&more);
        trainer.insert(&[]);
        trainer.retain(&vec![true; trainer.len()]);
    }
    assert_eq!(gpu.snapshot(), cpu.snapshot());
    assert_eq!((gpu.opacities(), gpu.positions_w()), (cpu.opacities(), cpu.positions_w()));
    assert_eq!(gpu.model(), cpu.model());
    let none = vec![false; gpu.len()];
    gpu.retain(&none);
    assert!(gpu.is_empty());
    let empty = gpu.render(&camera(SIZE));
    assert!(empty.color.iter().all(|c| *c == BACKGROUND) && empty.alpha.iter().all(|a| *a == 0.0));
    assert_eq!(gpu.steps(&[0, 1]).steps, 2);
    gpu.insert(&more);
    assert!(gpu.steps(&[0]).loss.total.is_finite());
    assert_eq!(gpu.failure(), None);
}

#[test]
fn room_for_pairs_grows_without_losing_a_step() {
    let Some((mut cpu, mut gpu)) = filled_pair(&TrainConfig::default(), FAST) else {
        return;
    };
    gpu.shrink_pairs(100);
    let (a, b) = (gpu.steps(&[0, 1, 0, 1]), cpu.steps(&[0, 1, 0, 1]));
    assert_eq!(gpu.failure(), None);
    assert!(gpu.pairs() > 100, "it did overflow");
    assert_eq!(a.steps, 4);
    assert!((a.loss.total / b.loss.total - 1.0).abs() < 1e-4, "{:?} {:?}", a.loss, b.loss);
    let steps = Parameters::decode(&gpu.snapshot()).unwrap().steps;
    assert_eq!(steps, Parameters::decode(&cpu.snapshot()).unwrap().steps);
    gpu.shrink_pairs(100);
    let spread = images(&gpu.render(&camera(SIZE)), &cpu.render(&camera(SIZE)));
    assert!(spread.p999 < 1e-4, "{spread}");
}

#[test]
fn long_lists_are_sorted_too() {
    let (Some(mut gpu), mut cpu) =
        (gpu(&TrainConfig::default(), FAST), CpuTrainer::new(&TrainConfig::default(), CLASSES, SEED))
    else {
        return;
    };
    // Thousands of faint discs over a few tiles: lists too long for sorting in workgroup memory.
    let camera = camera((24, 16));
    let mut seedlings = crate::probe::seedlings(&camera, 3000, Seed(8));
    for s in &mut seedlings {
        s.opacity = 0.02;
        s.scale *= 12.0;
    }
    agree_on("long lists", &mut gpu, &mut cpu, &camera, &seedlings);
}

/// Asserts that both back ends agree on the rendering and on the gradients of a step on one frame; returns the
/// pairs of the view.
fn agree_on(
    what: &str,
    gpu: &mut GpuTrainer,
    cpu: &mut CpuTrainer,
    camera: &Camera,
    seedlings: &[Seedling],
) -> u32 {
    for trainer in [cpu as &mut dyn Trainer, gpu] {
        trainer.insert(seedlings);
        trainer.add_frame(frame(camera, Seed(4)));
    }
    let spread = images(&gpu.render(camera), &cpu.render(camera));
    let pairs = gpu.last_pairs();
    println!("{what}: {pairs} pairs, image {spread}");
    assert!(spread.p999 <= 1e-5, "{spread}");
    gpu.steps(&[0]);
    cpu.steps(&[0]);
    for (name, spread) in first_moments(&gpu.snapshot(), &cpu.snapshot()).unwrap() {
        assert!(spread.p999 <= 1e-3, "{name}: {spread}");
    }
    pairs
}

#[test]
fn splats_over_many_tiles_are_listed_whole() {
    let (Some(mut gpu), mut cpu) =
        (gpu(&TrainConfig::default(), FAST), CpuTrainer::new(&TrainConfig::default(), CLASSES, SEED))
    else {
        return;
    };
    // More rows of tiles than a workgroup has lanes, more tiles than all lanes that visit a splat, and more large
    // splats than are visited at once.
    let camera = camera((64, 1100));
    let mut seedlings = crate::probe::seedlings(&camera, 300, Seed(8));
    for s in &mut seedlings {
        s.opacity = 0.05;
        s.scale *= 3.0;
    }
    let pairs = agree_on("large splats", &mut gpu, &mut cpu, &camera, &seedlings);
    assert!(pairs > 300 * 500, "they meet hundreds of tiles each: {pairs}");
}

#[test]
fn a_lost_device_is_told_and_nothing_panics() {
    let Some(mut gpu) = gpu(&TrainConfig::default(), FAST) else {
        return;
    };
    fill(&mut gpu, SIZE, COUNT);
    gpu.steps(&[0]);
    assert_eq!(gpu.failure(), None);
    gpu.lose_device();
    gpu.steps(&[0, 1]);
    let failure = gpu.failure().expect("the loss is detected");
    println!("after the loss: {failure}");
    assert_eq!(gpu.len(), COUNT);
    let maps = gpu.render(&camera(SIZE));
    assert_eq!(maps.color.len(), SIZE.0 * SIZE.1);
    assert_eq!(gpu.positions_w().len(), COUNT);
    assert!(Parameters::decode(&gpu.snapshot()).is_ok());
    gpu.retain(&[false; COUNT]);
    gpu.insert(&crate::probe::seedlings(&camera(SIZE), 4, Seed(1)));
    gpu.add_frame(frame(&camera(SIZE), Seed(1)));
    assert_eq!(gpu.failure(), Some(failure), "the first cause is kept");
}

#[test]
fn the_self_check_passes_and_finds_faults() {
    let Some(choice) = adapter() else {
        return;
    };
    let check = crate::self_check(choice).unwrap();
    println!("self-check: {check}");
    assert_eq!(check.fault(), None);
    let far = ErrorSpread { p999: 0.1, max: 1.0 };
    let [image, gradient] = [SelfCheck { image: far, ..check }, SelfCheck { gradient: far, ..check }];
    let loss = SelfCheck { loss: f64::NAN, ..check };
    let faults = [image, gradient, loss].map(|c| c.fault().unwrap());
    assert!(faults[0] != faults[1] && faults[1] != faults[2] && faults[2] != faults[0], "{faults:?}");
    assert!(crate::checked_trainer(&TrainConfig::default(), 3, SEED, choice).is_ok());
    assert!(matches!(
        crate::checked_trainer(&TrainConfig::default(), 3, SEED, AdapterChoice::Index(99)),
        Err(crate::GpuError::NoSuchAdapter { index: 99, .. })
    ));
    assert!(matches!(
        GpuTrainer::new(&TrainConfig::default(), 65, SEED, choice),
        Err(crate::GpuError::TooManyClasses { classes: 65, .. })
    ));
}

#[test]
#[ignore = "long: compiles three sets of kernels"]
fn long_any_number_of_classes_has_the_same_gradients() {
    let Some(choice) = adapter() else {
        return;
    };
    let config = TrainConfig { rates: still(), ..TrainConfig::default() };
    for classes in [1, 9, 33] {
        let mut cpu = CpuTrainer::new(&config, classes, SEED);
        let mut gpu = GpuTrainer::new(&config, classes, SEED, choice).unwrap();
        for trainer in [&mut cpu as &mut dyn Trainer, &mut gpu] {
            fill(trainer, (24, 17), 40);
            trainer.steps(&[0]);
        }
        for (name, spread) in first_moments(&gpu.snapshot(), &cpu.snapshot()).unwrap() {
            assert!(spread.p999 <= 1e-3, "{classes} classes, {name}: {spread}");
        }
        let view = camera((24, 17));
        assert_eq!(gpu.render(&view).label, cpu.render(&view).label);
    }
}
