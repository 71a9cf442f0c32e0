//! Materials `vlm`: estimates of a vision-language model for the objects of a scan.
//!
//! The views for the model are kept with the scanned scene, so that it can be asked later and on another machine. They contain
//! nothing of the truth except the camera's view.

use crate::BenchError;
use serde::{Deserialize, Serialize};
use sms_core::{Cancel, CoreError, InputError, Labels, MaskSource, Progress, StageContext, Warnings, atomic};
use sms_entities::{EntitySet, material_queries};
use sms_frames::Sequence;
use sms_materials::{MaterialTable, ObjectQuery, assign};
use sms_scene::{BodyShape, Scene};
use sms_vlm::{Cache, Client, Question, VlmConfig, ask, question_about};
use std::path::Path;

/// File of the questions in a kept scene's folder.
const QUESTIONS: &str = "questions.json";

/// Queries about a scan's objects, and the questions with pictures.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct KeptQuestions {
    /// The entities in their order, then the floor.
    queries: Vec<ObjectQuery>,
    questions: Vec<KeptQuestion>,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct KeptQuestion {
    /// Index of the query.
    query: usize,
    is_surface: bool,
    /// The picture, beside this file.
    jpeg: String,
}

/// Keeps the best view of every entity of a scan, and of its floor, in `dir`.
pub(crate) fn keep_questions(
    dir: &Path,
    set: &EntitySet,
    sequence: &Sequence,
    labels: &Labels,
) -> Result<(), CoreError> {
    let mut queries = material_queries(set);
    if labels.source == MaskSource::Truth {
        // True masks come with true names.
        for (i, query) in queries.iter_mut().take(set.entities.len()).enumerate() {
            query.description.clear();
            query.name = set.entities[i].name.clone();
        }
    }
    let config = VlmConfig::default();
    let mut questions = Vec::new();
    for (i, query) in queries.iter().enumerate() {
        let entity = set.entities.get(i);
        let Some(q) = question_about(query, entity, set.support_height, sequence, labels, &config) else {
            continue;
        };
        let jpeg = format!("view_{i:02}.jpg");
        atomic::write_bytes(&dir.join(&jpeg), &q.jpeg)?;
        questions.push(KeptQuestion { query: i, is_surface: q.is_surface, jpeg });
    }
    atomic::write_json(&dir.join(QUESTIONS), &KeptQuestions { queries, questions })
}

/// Asks about the objects of the scene kept in `dir` and sets the materials of `scene`. Unanswered properties keep the prior.
/// Replies are kept in `cache`.
///
/// # Errors
/// [`BenchError::Input`] where the scene was kept without views; [`BenchError::Unanswered`] where the server stops answering;
/// [`BenchError::Core`] for files and interruption.
pub(super) fn apply_vlm_materials(
    scene: &mut Scene,
    dir: &Path,
    client: &Client,
    cache: &Path,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<(), BenchError> {
    let path = dir.join(QUESTIONS);
    if !path.is_file() {
        let cure = "scan again with --rescan, or leave `vlm` out of --materials";
        return Err(InputError::new("this scan was kept without views of its objects", dir, cure).into());
    }
    let KeptQuestions { mut queries, questions } = atomic::read_json(&path)?;
    let asked_about: Vec<Question> = questions
        .iter()
        .map(|q| {
            let file = dir.join(&q.jpeg);
            let query = queries.get(q.query).ok_or_else(|| {
                InputError::new("a question is about nothing", &path, "scan again with --rescan")
            })?;
            Ok(Question {
                name: query.name.clone(),
                annotation: query.description.clone(),
                is_surface: q.is_surface,
                jpeg: std::fs::read(&file).map_err(CoreError::read(&file))?,
            })
        })
        .collect::<Result<_, BenchError>>()?;
    let warnings = Warnings::new();
    let context = StageContext::new(progress, cancel, &warnings);
    let answers = ask(&asked_about, client, &Cache::new(cache), context)?;
    // An object that the model cannot answer keeps the prior: that is part of the model's quality. A model that was not asked has no figure.
    if let Some(why) = &answers.given_up {
        let at = client.config().url.clone();
        return Err(BenchError::Unanswered(InputError::new(why.what.clone(), at, why.cure.clone())));
    }
    for (question, outcome) in questions.iter().zip(&answers.outcomes) {
        queries[question.query].estimate = outcome.answer().cloned();
    }
    let table = MaterialTable::builtin();
    let materials = assign(&queries, &table, None, &warnings)?;
    let floor = queries.len().saturating_sub(1);
    for body in &mut scene.bodies {
        let query = match body.shape {
            BodyShape::HalfSpace => Some(floor),
            _ => queries[..floor].iter().position(|q| q.name == body.name),
        };
        if let Some(i) = query.filter(|i| queries[*i].estimate.is_some()) {
            crate::material_prior::set_material(body, materials[i].clone());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::billiards::planner_view::scan_dir;
    use crate::{BenchScene, BilliardsGeometry, MaterialPrior, read_billiards, run_billiards};
    use sms_core::{NoProgress, PropertySource, Seed};
    use sms_scene::save_scene;
    use sms_synth::FIXED_SCENES;
    use sms_target::scene_from_truth;
    use sms_vlm::{Pause, Reply, Request, Transport, TransportError};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

    /// Gives the same answer a number of times, then refuses the key.
    struct Says(AtomicUsize);

    impl Transport for Says {
        fn post(&self, _: &Request) -> Result<Reply, TransportError> {
            let is_left = self.0.fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1)).is_ok();
            let said = r#"{"material": "brass", "density": {"best": 8500, "low": 8000, "high": 8800}, "friction": 0.3}"#;
            let body =
                serde_json::json!({"choices": [{"message": {"content": said}, "finish_reason": "stop"}]});
            let status = if is_left { 200 } else { 401 };
            Ok(Reply { status, retry_after: None, body: body.to_string().into_bytes() })
        }
    }

    struct Never;

    impl Pause for Never {
        fn pause(&self, _: f64, _: &Cancel) -> Result<(), CoreError> {
            Ok(())
        }
    }

    fn client(answers: usize) -> Client {
        let config = VlmConfig { url: "http://server/v1".into(), model: "m".into(), ..VlmConfig::default() };
        Client::with(&config, None, Seed(0), Arc::new(Says(answers.into())), Arc::new(Never)).unwrap()
    }

    #[test]
    fn what_a_model_says_is_told_and_of_what_it_was_not_asked_the_prior_stays() {
        let folder = tempfile::tempdir().unwrap();
        let mut scene = scene_from_truth(&FIXED_SCENES[1].generate()).unwrap();
        scene.bodies.iter_mut().for_each(super::super::planner_view::forget_material);
        let before = scene.clone();
        let tell = |scene: &mut Scene, answers| {
            let cache = folder.path().join("vlm");
            apply_vlm_materials(scene, folder.path(), &client(answers), &cache, &NoProgress, &Cancel::new())
        };
        assert!(tell(&mut scene, 9).unwrap_err().to_string().contains("without views"));

        let name = |i: usize| scene.bodies[i].name.clone();
        let query = |name: String| ObjectQuery { name, ..ObjectQuery::default() };
        // The floor comes first among bodies and last among queries; the third body is not asked about.
        let queries = vec![query(name(1)), query(name(2)), query("floor".into())];
        let question =
            |query: usize| KeptQuestion { query, is_surface: query == 2, jpeg: format!("{query}.jpg") };
        for i in [0, 2] {
            std::fs::write(folder.path().join(format!("{i}.jpg")), [0xFF, 0xD8, i as u8]).unwrap();
        }
        let kept = KeptQuestions { queries, questions: vec![question(0), question(2)] };
        atomic::write_json(&folder.path().join(QUESTIONS), &kept).unwrap();

        // The second try hears of one of the two, and no more.
        for answers in [0, 1] {
            let Err(BenchError::Unanswered(why)) = tell(&mut scene, answers) else { panic!("it stops") };
            assert!(why.to_string().contains("http://server"), "{why}");
            assert_eq!(scene, before, "a failure changes nothing");
        }
        tell(&mut scene, 9).unwrap();
        assert_eq!(scene.bodies[2..], before.bodies[2..]);
        for i in [0, 1] {
            let material = &scene.bodies[i].material;
            assert_eq!((material.friction.value.best, material.density.value.best), (0.3, 8500.0));
            assert_eq!(material.density.source, PropertySource::Vlm);
        }
        let (was, is) = (before.bodies[1].mass.unwrap().mass(), scene.bodies[1].mass.unwrap().mass());
        let ratio =
            scene.bodies[1].material.effective_density() / before.bodies[1].material.effective_density();
        assert!((is / was / ratio - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_model_that_does_not_answer_costs_its_own_row_only() {
        let dir = tempfile::tempdir().unwrap();
        let mut bench = super::super::run::tests::tiny(dir.path(), &[1]);
        bench.geometry = BilliardsGeometry::Scan;
        bench.material_prior = vec![MaterialPrior::Vlm, MaterialPrior::Class];
        bench.vlm = Some(Arc::new(client(0)));
        // The truth in place of a scan: its geometry at best.
        let mut scene = scene_from_truth(&bench.scenes[0].generate()).unwrap();
        scene.bodies.iter_mut().for_each(super::super::planner_view::forget_material);
        let ball = ObjectQuery { name: scene.bodies[1].name.clone(), ..ObjectQuery::default() };
        let question = KeptQuestion { query: 0, is_surface: false, jpeg: "0.jpg".into() };
        let kept = KeptQuestions { queries: vec![ball, ObjectQuery::default()], questions: vec![question] };
        for entities in [&bench.scan.bench.entities, &bench.paper_entities] {
            let scan = scan_dir(&bench.scan, &BenchScene::Fixed(1), entities).unwrap();
            save_scene(&scan, &scene).unwrap();
            atomic::write_bytes(&scan.join("0.jpg"), &[0xFF, 0xD8]).unwrap();
            atomic::write_json(&scan.join(QUESTIONS), &kept).unwrap();
        }
        let run = || run_billiards(&bench, &|_| {}, &NoProgress, &Cancel::new()).unwrap();
        assert!(run().unwrap().to_string().contains("http://server"));
        let ran: Vec<MaterialPrior> =
            read_billiards(&bench).unwrap().iter().map(|s| s.material_prior).collect();
        assert_eq!(ran, [MaterialPrior::Class]);
    }
}
