//! Streams a running scan to a Rerun viewer (feature `rerun`).
//!
//! Timelines: `step` (training steps; holds all data, and the viewer follows it) and `frame`. Entities: `world/camera`
//! with `observed` and `rendered` pictures and depth below it, `world/path` (camera path), `world/gaussians`,
//! `losses/*` and `scan/*` (number of Gaussians, PSNR of the last frame).
//!
//! A separate thread serves the viewer: if the viewer is slow, hangs or is closed, messages are dropped and the scan
//! continues.

use crate::rerun_parts::{
    APPLICATION, GaussianPoints, Logged, bytes_of, color_image, depth_image, pinhole, transform,
};
use rerun::blueprint::components::{PanelState, PlayState};
use rerun::blueprint::{
    Blueprint, BlueprintActivation, Grid, Horizontal, Spatial2DView, Spatial3DView, TimePanel,
    TimeSeriesView, Vertical,
};
use rerun::{RecordingStream, RecordingStreamBuilder};
use sms_core::{Camera, InputError};
use sms_gaussians::{BatchDone, ScanObserver, SlotDone};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

/// Default port of a viewer.
const PORT: u16 = rerun::DEFAULT_SERVER_PORT;
/// Largest number of Gaussians shown after a frame, and at the end.
const MOST_POINTS: (usize, usize) = (30_000, 200_000);
/// Largest number of messages in the queue; the message of a frame has several megabytes.
const WAITING: usize = 32;
/// Timeout of a viewer for answering, and for receiving the remaining data at the end.
const PATIENCE: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 10 });

/// The viewer to stream to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Viewer {
    /// The viewer that is open on this machine, or a new one.
    Any,
    /// The viewer at an address: `host:port`, or `rerun+http://host:port/proxy`.
    At(String),
}

/// An error of a live view, which does not affect the scan.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// No viewer was found.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The SDK failed.
    #[error("cannot stream to the Rerun viewer: {0}")]
    Sdk(#[from] rerun::RecordingStreamError),
    /// The viewer was closed, or it was too slow.
    #[error("the Rerun viewer did not receive all data: {0}")]
    Behind(String),
}

enum Message {
    Completed,
    Batch(BatchDone),
    Slot(Box<FrameUpdate>),
}

/// Data of a finished frame.
struct FrameUpdate {
    step: u64,
    frame: usize,
    is_last: bool,
    camera: Camera,
    observed: (Vec<u8>, Vec<f32>),
    rendered: (Vec<u8>, Vec<f32>),
    points: GaussianPoints,
    psnr_db: f64,
}

/// Streams a scan to a viewer.
#[derive(Debug)]
pub struct LiveScan {
    sender: Option<SyncSender<Message>>,
    /// Receives the result of the thread.
    ended: Receiver<Result<(), String>>,
    dropped: usize,
}

impl LiveScan {
    /// Connects to a viewer, or starts one, and sends the layout; `name` is the name of the recording.
    ///
    /// # Errors
    /// [`LiveError::Input`] if no viewer answers or none is installed.
    pub fn start(viewer: &Viewer, name: &str) -> Result<Self, LiveError> {
        let builder = RecordingStreamBuilder::new(APPLICATION).recording_name(format!("scan of {name}"));
        let rec = match viewer {
            Viewer::At(address) => {
                let url = url_of(address)?;
                if !answers(&url) {
                    return Err(InputError::new(
                        "no Rerun viewer answers",
                        address,
                        "start a viewer there (`rerun`), or use --live without an address",
                    )
                    .into());
                }
                builder.connect_grpc_opts(url)?
            }
            Viewer::Any => builder.spawn_opts(&spawn_options()).map_err(not_installed)?,
        };
        blueprint().send(&rec, BlueprintActivation { make_active: true, make_default: true })?;
        rec.log_static("world", &rerun::ViewCoordinates::RIGHT_HAND_Z_UP())?;
        Ok(Self::serve(rec))
    }

    /// Starts the thread that logs the messages.
    fn serve(rec: RecordingStream) -> Self {
        let (sender, receiver) = sync_channel(WAITING);
        let (ended_sender, ended) = sync_channel(1);
        std::thread::spawn(move || {
            let logged = log_all(&rec, &receiver).map_err(|e| e.to_string());
            let flushed = rec.flush_with_timeout(PATIENCE).map_err(|e| e.to_string());
            // The receiver may have timed out.
            let _ = ended_sender.send(logged.and(flushed));
        });
        Self { sender: Some(sender), ended, dropped: 0 }
    }

    fn send(&mut self, message: Message) {
        let Some(sender) = &self.sender else { return };
        match sender.try_send(message) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => self.dropped += 1,
            Err(TrySendError::Disconnected(_)) => self.sender = None,
        }
    }

    /// Waits, with a timeout, until the viewer has received all data.
    ///
    /// # Errors
    /// [`LiveError::Behind`] if it has not.
    pub fn finish(mut self) -> Result<(), LiveError> {
        drop(self.sender.take());
        let ended = match self.ended.recv_timeout(2 * PATIENCE) {
            Ok(ended) => ended,
            Err(RecvTimeoutError::Timeout) => Err("it stopped answering".to_owned()),
            Err(RecvTimeoutError::Disconnected) => Err("the stream ended unexpectedly".to_owned()),
        };
        match (ended, self.dropped) {
            (Ok(()), 0) => Ok(()),
            (Ok(()), n) => Err(LiveError::Behind(format!("it was too slow, and {n} messages were dropped"))),
            (Err(why), _) => Err(LiveError::Behind(why)),
        }
    }
}

impl ScanObserver for LiveScan {
    fn completed(&mut self) {
        self.send(Message::Completed);
    }

    fn batch(&mut self, batch: &BatchDone) {
        self.send(Message::Batch(*batch));
    }

    fn slot(&mut self, slot: &SlotDone<'_>) {
        let is_last = slot.slot == slot.frames;
        let most = if is_last { MOST_POINTS.1 } else { MOST_POINTS.0 };
        let rendered: Vec<[u8; 3]> = slot.rendered.color.iter().map(|&c| bytes_of(c)).collect();
        self.send(Message::Slot(Box::new(FrameUpdate {
            step: slot.step,
            frame: slot.frame.index,
            is_last,
            camera: slot.frame.camera,
            observed: (slot.frame.color.data.as_flattened().to_vec(), slot.frame.depth.data.clone()),
            rendered: (rendered.into_flattened(), slot.rendered.depth.clone()),
            points: GaussianPoints::of(&(slot.model)(), most),
            psnr_db: slot.score.psnr_db,
        })));
    }
}

fn log_all(rec: &RecordingStream, messages: &Receiver<Message>) -> Logged {
    let mut path: Vec<[f32; 3]> = Vec::new();
    while let Ok(message) = messages.recv() {
        match message {
            Message::Completed => {
                // The cameras of the scan lie in another world.
                path.clear();
                rec.log("world/path", &rerun::Clear::flat())?;
            }
            Message::Batch(batch) => log_batch(rec, &batch)?,
            Message::Slot(slot) => log_slot(rec, *slot, &mut path)?,
        }
    }
    Ok(())
}

fn log_batch(rec: &RecordingStream, batch: &BatchDone) -> Logged {
    let loss = batch.sample.loss;
    rec.set_time_sequence("step", batch.sample.step as i64);
    if let Some(frame) = batch.sample.frame {
        rec.set_time_sequence("frame", frame as i64);
    }
    for (name, value) in [
        ("losses/color_l1", f64::from(loss.color_l1)),
        ("losses/depth_m", f64::from(loss.depth)),
        ("losses/segmentation", f64::from(loss.segmentation)),
        ("losses/total", f64::from(loss.total)),
        ("scan/gaussians", batch.sample.gaussians as f64),
    ] {
        rec.log(name, &rerun::Scalars::new([value]))?;
    }
    Ok(())
}

fn log_slot(rec: &RecordingStream, slot: FrameUpdate, path: &mut Vec<[f32; 3]>) -> Logged {
    rec.set_time_sequence("step", slot.step as i64);
    rec.set_time_sequence("frame", slot.frame as i64);
    rec.log("world/camera", &transform(&slot.camera.x_wc))?;
    let size = [slot.camera.intrinsics.width as u32, slot.camera.intrinsics.height as u32];
    for (name, (color, depth)) in [("observed", slot.observed), ("rendered", slot.rendered)] {
        let at = format!("world/camera/{name}");
        rec.log(at.clone(), &pinhole(&slot.camera))?;
        rec.log(format!("{at}/color"), &color_image(color, size))?;
        rec.log(format!("{at}/depth"), &depth_image(&depth, size))?;
    }
    if !slot.is_last {
        path.push(slot.camera.x_wc.translation.as_vec3().to_array());
        let line = rerun::LineStrips3D::new([path.clone()])
            .with_radii([0.001])
            .with_colors([rerun::Color::from_rgb(90, 90, 90)]);
        rec.log("world/path", &line)?;
        rec.log("scan/psnr_db", &rerun::Scalars::new([slot.psnr_db]))?;
    }
    rec.log("world/gaussians", &slot.points.archetype())
}

/// Lays out the scene beside the pictures and the curves; the time panel follows the training.
fn blueprint() -> Blueprint {
    let picture = |name: &str, what: &str, kind: &str| {
        Spatial2DView::new(format!("{name} {what}"))
            .with_origin(format!("world/camera/{name}"))
            .with_contents([format!("world/camera/{name}/{kind}")])
    };
    Blueprint::new(Horizontal::new([
        Spatial3DView::new("scene")
            .with_origin("world")
            .with_contents(["world/gaussians", "world/path", "world/camera", "world/camera/observed"])
            .into(),
        Vertical::new([
            Grid::new([
                picture("observed", "colour", "color").into(),
                picture("rendered", "colour", "color").into(),
                picture("observed", "depth", "depth").into(),
                picture("rendered", "depth", "depth").into(),
            ])
            .into(),
            TimeSeriesView::new("losses").with_origin("losses").into(),
            TimeSeriesView::new("PSNR of the last frame, dB").with_origin("scan/psnr_db").into(),
        ])
        .into(),
    ]))
    .with_time_panel(
        TimePanel::new()
            .with_timeline("step")
            .with_play_state(PlayState::Following)
            .with_state(PanelState::Collapsed),
    )
}

fn spawn_options() -> rerun::SpawnOptions {
    rerun::SpawnOptions { wait_for_bind: true, hide_welcome_screen: true, ..rerun::SpawnOptions::default() }
}

fn not_installed(error: rerun::RecordingStreamError) -> LiveError {
    match error {
        rerun::RecordingStreamError::SpawnViewer(why) => InputError::new(
            "no Rerun viewer is open, and starting one failed",
            "rerun (on the PATH)",
            format!(
                "install the matching version: pip install rerun-sdk=={0}, or cargo install rerun-cli --version {0}; \
                 or start a viewer elsewhere and use --live=HOST:PORT",
                rerun::build_info().version
            ),
        )
        .because(why.to_string().lines().next().unwrap_or_default())
        .into(),
        other => other.into(),
    }
}

/// Converts `host:port` and `host` to the viewer's URL; keeps URLs.
fn url_of(address: &str) -> Result<String, InputError> {
    if address.contains("://") {
        let known = ["rerun://", "rerun+http://", "rerun+https://"].iter().any(|s| address.starts_with(s));
        if known && address.trim_end_matches('/').ends_with("/proxy") {
            return Ok(address.to_owned());
        }
        if known && address.split("://").nth(1).is_some_and(|rest| !rest.trim_end_matches('/').contains('/'))
        {
            return Ok(format!("{}/proxy", address.trim_end_matches('/')));
        }
    } else if let Some((host, port)) = address.rsplit_once(':') {
        if !host.is_empty() && port.parse::<u16>().is_ok() {
            return Ok(format!("rerun+http://{address}/proxy"));
        }
    } else if !address.is_empty() && !address.contains(['/', ' ']) {
        return Ok(format!("rerun+http://{address}:{PORT}/proxy"));
    }
    Err(InputError::new(
        "this is not the address of a Rerun viewer",
        address,
        format!("use host:port or rerun+http://host:port/proxy; viewers listen on port {PORT} by default"),
    ))
}

/// Returns whether a server listens at the URL.
fn answers(url: &str) -> bool {
    let Some(place) = url.split("://").nth(1).and_then(|rest| rest.split('/').next()) else { return false };
    let place = if place.rsplit_once(':').is_some_and(|(_, p)| p.parse::<u16>().is_ok()) {
        place.to_owned()
    } else {
        format!("{place}:{PORT}")
    };
    let deadline = Instant::now() + PATIENCE;
    let Ok(addresses) = place.to_socket_addrs() else { return false };
    addresses.into_iter().any(|address| {
        let left = deadline.saturating_duration_since(Instant::now()).max(Duration::from_millis(100));
        TcpStream::connect_timeout(&address, left.min(Duration::from_secs(3))).is_ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_become_urls_or_are_refused() {
        for (given, url) in [
            ("127.0.0.1:9876", "rerun+http://127.0.0.1:9876/proxy"),
            ("desk", "rerun+http://desk:9876/proxy"),
            ("rerun+http://desk:1234/proxy", "rerun+http://desk:1234/proxy"),
            ("rerun+http://desk:1234", "rerun+http://desk:1234/proxy"),
            ("[::1]:9876", "rerun+http://[::1]:9876/proxy"),
        ] {
            assert_eq!(url_of(given).unwrap(), url);
        }
        for wrong in ["", ":9876", "desk:port", "http://desk:9876/proxy", "desk/9876", "rerun://desk/x"] {
            assert!(url_of(wrong).unwrap_err().to_string().contains("host:port"), "{wrong}");
        }
    }

    #[test]
    fn a_viewer_that_is_not_there_is_an_input_error() {
        // A port without a server.
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let error = LiveScan::start(&Viewer::At(format!("127.0.0.1:{port}")), "x").unwrap_err();
        assert!(matches!(&error, LiveError::Input(e) if e.to_string().contains("no Rerun viewer answers")));
    }

    fn batch() -> BatchDone {
        let sample = sms_gaussians::LossSample {
            step: 10,
            frame: Some(0),
            loss: sms_gaussians::LossTerms::default(),
            gaussians: 5,
        };
        BatchDone { sample, slot: 0, frames: 1, step: 10, steps: 20, seconds_left: None }
    }

    #[test]
    fn what_is_sent_is_logged() {
        let (rec, storage) = RecordingStreamBuilder::new("test").memory().unwrap();
        let mut live = LiveScan::serve(rec);
        live.batch(&batch());
        live.finish().unwrap();
        assert!(storage.num_msgs() > 0);
    }

    #[test]
    fn a_viewer_that_hangs_holds_nobody_up_and_is_named_at_the_end() {
        // A server that accepts connections (by the operating system) and never reads.
        let hangs = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = hangs.local_addr().unwrap().to_string();
        let mut live = LiveScan::start(&Viewer::At(address), "x").unwrap();
        (0..100_000).for_each(|_| live.batch(&batch()));
        assert!(matches!(live.finish(), Err(LiveError::Behind(_))));
    }
}
