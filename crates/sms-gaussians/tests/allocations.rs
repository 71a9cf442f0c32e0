//! A step allocates nothing once its buffers have grown.
#![expect(unsafe_code, reason = "a global allocator that counts; every call goes on to the system's")]

use sms_core::glamx::{DPose3, Quat, Vec3};
use sms_core::{Camera, Intrinsics, Seed};
use sms_gaussians::{
    AFFINITY_DIM, CpuTrainer, LearningRates, Seedling, SimdForm, TrainConfig, TrainFrame, Trainer,
};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: all calls are forwarded to `System` unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A wall of discs before two cameras, with a checkerboard as the observation.
fn trainer(form: SimdForm, share: f32) -> CpuTrainer {
    // Gaussians do not move, so that no list grows from one step to the next.
    let rates = LearningRates {
        position: 0.0,
        log_scale: 0.0,
        rotation: 0.0,
        off_plane: 1.0,
        opacity: 0.0,
        color: 0.0,
        harmonics: 0.0,
        affinity: 0.0,
        classifier: 0.0,
    };
    let config = TrainConfig { rates, segmentation_share: share, ..TrainConfig::default() };
    let mut trainer = CpuTrainer::with_form(&config, 3, Seed(1), form).expect("an available form");
    let (width, height) = (90, 70);
    let discs = |i: usize| {
        let (x, y) = ((i % 40) as f32 / 40.0 - 0.5, (i / 40) as f32 / 40.0 - 0.5);
        Seedling {
            position_w: Vec3::new(x, y, 1.0 + 0.1 * (9.0 * x).sin()),
            rotation_wg: Quat::IDENTITY,
            scale: Vec3::new(0.02, 0.015, 0.003),
            opacity: 0.7,
            color: [0.5 + x, 0.5 + y, 0.3],
            harmonics: sms_gaussians::harmonics::CONSTANT,
            affinity: [x; AFFINITY_DIM],
        }
    };
    trainer.insert(&(0..1600).map(discs).collect::<Vec<_>>());
    for x in [0.0, 0.1] {
        let pose = DPose3::translation(x, 0.0, 0.0);
        let checker = |i: usize| (i % width / 10 + i / width / 10) % 2;
        trainer.add_frame(TrainFrame {
            camera: Camera::new(Intrinsics::from_fov(width, height, 1.0), pose),
            color: (0..width * height).map(|i| [checker(i) as f32; 3]).collect(),
            depth: vec![1.0; width * height],
            normal_w: vec![[0.0, 0.0, -1.0]; width * height],
            label: (0..width * height).map(|i| checker(i) as u16).collect(),
        });
    }
    trainer
}

#[test]
fn steps_allocate_nothing_after_the_first_ones() {
    // One thread: with several, rayon's queues allocate a little when work is stolen.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        for &form in SimdForm::available() {
            for share in [1.0, 0.5] {
                let mut trainer = trainer(form, share);
                trainer.steps(&[0, 1, 0, 1]);
                let before = ALLOCATIONS.load(Ordering::Relaxed);
                let stats = trainer.steps(&[0, 1, 0, 1, 1, 0, 0, 1]);
                let allocations = ALLOCATIONS.load(Ordering::Relaxed) - before;
                assert_eq!((stats.steps, allocations), (8, 0), "{form:?}, share {share}");
            }
        }
    });
}
