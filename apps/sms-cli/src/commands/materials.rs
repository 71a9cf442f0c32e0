//! `sms materials`: what the objects of a scene are made of, and the user's changes to it.

use super::shown;
use crate::cli::Materials;
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Material, Property, PropertySource, RunFolder, Warnings};
use sms_materials::{MaterialTable, ObjectQuery, Overrides, assign, load_queries};
use sms_scene::load_scene;
use std::path::Path;

/// The user's changes, in the run's folder; the same form as `sms materialize --materials FILE`.
pub(crate) const EDITS: &str = "materials.toml";
/// What was known of the objects, in the scene's folder.
pub(crate) const QUERIES: &str = "materials.json";

pub(crate) fn run(console: &Console, a: &Materials) -> anyhow::Result<()> {
    let is_edit = !a.set.is_empty() || !a.unset.is_empty();
    let run = if is_edit { RunFolder::open(&a.run)? } else { RunFolder::open_to_read(&a.run)? };
    let scene_dir = run.stage_dir("scene", "materialize")?;
    let objects = known(&scene_dir)?;
    let table = MaterialTable::builtin();
    let path = run.root().join(EDITS);
    let mut overrides = Overrides::read_optional(&path)?;
    for text in &a.unset {
        unset(&mut overrides, text, &objects)?;
    }
    for text in &a.set {
        set(&mut overrides, text, &objects, &table)?;
    }
    overrides.check(&objects, &table)?;
    if is_edit {
        overrides.save(&path)?;
    }
    let materials = assign(&objects, &table, Some(&overrides), &Warnings::new())?;
    if console.json {
        return console.print_json(&metrics(&objects, &materials));
    }
    console.say(listing(&objects, &materials));
    if is_edit {
        console.say(format!("  in {}", shown(&path)));
    }
    let changed = changed(&scene_dir, &objects, &materials)?;
    if !changed.is_empty() {
        console.say(format!(
            "the scene as it stands has other values for {}: run `sms materialize {}` to make it with these",
            changed.join(", "),
            a.run.display()
        ));
    }
    Ok(())
}

fn known(scene_dir: &Path) -> anyhow::Result<Vec<ObjectQuery>> {
    let path = scene_dir.join(QUERIES);
    if !path.is_file() {
        return Err(InputError::new(
            "this scene was made by an earlier version, or is damaged",
            &path,
            "run `sms materialize` again",
        )
        .into());
    }
    Ok(load_queries(&path)?)
}

/// `OBJECT.KEY=VALUE`.
fn set(
    overrides: &mut Overrides,
    text: &str,
    objects: &[ObjectQuery],
    table: &MaterialTable,
) -> Result<(), InputError> {
    let given = format!("--set {text}");
    let malformed = || {
        InputError::new(
            "this is no assignment",
            &given,
            "write OBJECT.KEY=VALUE, such as --set object_01.density=2400 or --set object_01.friction=0.4,0.3,0.5",
        )
    };
    let (target, value) = text.split_once('=').ok_or_else(malformed)?;
    let (name, key) = target.trim().rsplit_once('.').ok_or_else(malformed)?;
    object(name, &given, objects)?;
    let value = value.trim();
    if key == "class" && table.class(value).is_none() {
        let classes: Vec<&str> = table.classes().collect();
        return Err(InputError::new(
            format!("there is no class `{value}`"),
            given,
            format!("use one of: {}", classes.join(", ")),
        ));
    }
    if key == "mass_kg" && objects.iter().any(|o| o.name == name && o.volume_m3 <= 0.0) {
        return Err(InputError::new(format!("`{name}` is fixed and has no mass"), given, "leave it out"));
    }
    overrides.set(name, key, value)
}

/// `OBJECT` or `OBJECT.KEY`.
fn unset(overrides: &mut Overrides, text: &str, objects: &[ObjectQuery]) -> Result<(), InputError> {
    let given = format!("--unset {text}");
    let is_object =
        |name: &str| objects.iter().any(|o| o.name == name) || overrides.object.contains_key(name);
    let (name, key) = match text.rsplit_once('.') {
        Some((name, key)) if !is_object(text) => (name, Some(key)),
        _ => (text, None),
    };
    // What was set for an object that is no longer there can be taken back.
    if !is_object(name) {
        object(name, &given, objects)?;
    }
    if overrides.unset(name, key)? {
        return Ok(());
    }
    let what = key.map_or_else(|| "nothing is".to_owned(), |key| format!("{key} is not"));
    Err(InputError::new(
        format!("{what} set for `{name}`"),
        given,
        "`sms materials RUN` lists what is set: its source is `user`",
    ))
}

fn object(name: &str, given: &str, objects: &[ObjectQuery]) -> Result<(), InputError> {
    if objects.iter().any(|o| o.name == name) {
        return Ok(());
    }
    let names: Vec<&str> = objects.iter().map(|o| o.name.as_str()).collect();
    Err(InputError::new(
        format!("there is no object `{name}` in this scene"),
        given,
        format!("name one of: {}", names.join(", ")),
    ))
}

/// The properties in the order of the list, with their units.
fn properties(m: &Material) -> [(&'static str, Property, &'static str); 7] {
    [
        ("density", m.density, "kg/m³"),
        ("fill_factor", m.fill_factor, ""),
        ("friction", m.friction, ""),
        ("restitution", m.restitution, ""),
        ("rolling_m", m.rolling_m, "m"),
        ("youngs_modulus_pa", m.youngs_modulus_pa, "Pa"),
        ("poissons_ratio", m.poissons_ratio, ""),
    ]
}

fn source(property: Property) -> &'static str {
    match property.source {
        PropertySource::Vlm => "vlm",
        PropertySource::Table => "table",
        PropertySource::User => "user",
        PropertySource::Prior => "prior",
        PropertySource::Truth => "truth",
    }
}

/// A table with one line a value.
fn listing(objects: &[ObjectQuery], materials: &[Material]) -> String {
    let mut out = String::new();
    for (object, material) in objects.iter().zip(materials) {
        let called = object.estimate.as_ref().map_or(&object.description, |e| &e.label);
        let called =
            if called.is_empty() || *called == object.name { String::new() } else { format!(" ({called})") };
        out.push_str(&format!("{}{called}: {}\n", object.name, material.class));
        for (key, property, unit) in properties(material) {
            let v = property.value;
            let (best, range) = (number(v.best), format!("[{} – {}]", number(v.low), number(v.high)));
            out.push_str(
                format!("  {key:<18} {best:>10}  {range:<24} {unit:<6} {}", source(property)).trim_end(),
            );
            out.push('\n');
        }
        if object.volume_m3 > 0.0 {
            let mass = material.effective_density() * object.volume_m3;
            out.push_str(&format!("  {:<18} {:>10}  {:<24} kg\n", "mass", number(mass), ""));
        }
    }
    out.truncate(out.trim_end().len());
    out
}

/// A number in four digits.
fn number(x: f64) -> String {
    if x == 0.0 {
        return "0".into();
    }
    if (1e-3..1e5).contains(&x.abs()) {
        let decimals = (3 - x.abs().log10().floor() as i32).clamp(0, 6) as usize;
        let text = format!("{x:.decimals$}");
        return if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        } else {
            text
        };
    }
    let text = format!("{x:.3e}");
    match text.split_once('e') {
        Some((mantissa, power)) if mantissa.contains('.') => {
            format!("{}e{power}", mantissa.trim_end_matches('0').trim_end_matches('.'))
        }
        _ => text,
    }
}

fn metrics(objects: &[ObjectQuery], materials: &[Material]) -> Metrics {
    let mut m = Metrics::new();
    for (object, material) in objects.iter().zip(materials) {
        let name = &object.name;
        m.set(format!("materials.{name}.class"), material.class.clone());
        if object.volume_m3 > 0.0 {
            m.set(format!("materials.{name}.mass_kg"), material.effective_density() * object.volume_m3);
        }
        for (key, property, _) in properties(material) {
            let v = property.value;
            m.set(format!("materials.{name}.{key}"), v.best);
            m.set(format!("materials.{name}.{key}_low"), v.low)
                .set(format!("materials.{name}.{key}_high"), v.high);
            m.set(format!("materials.{name}.{key}_source"), source(property));
        }
    }
    m
}

/// The objects to which the scene as it was made gives another material.
fn changed(scene_dir: &Path, objects: &[ObjectQuery], materials: &[Material]) -> anyhow::Result<Vec<String>> {
    let scene = load_scene(scene_dir)?;
    let differs = |object: &ObjectQuery, material: &Material| {
        scene.bodies.iter().find(|b| b.name == object.name).is_some_and(|b| b.material != *material)
    };
    let pairs = objects.iter().zip(materials);
    Ok(pairs.filter(|(o, m)| differs(o, m)).map(|(o, _)| o.name.clone()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits() {
        for (x, text) in [
            (2400.0, "2400"),
            (0.4, "0.4"),
            (0.123_456, "0.1235"),
            (7e10, "7e10"),
            (1.05e11, "1.05e11"),
            (5e-5, "5e-5"),
            (0.0, "0"),
            (12.0, "12"),
            (99_999.0, "99999"),
        ] {
            assert_eq!(number(x), text);
        }
    }

    #[test]
    fn edits_name_what_is_wrong_and_change_nothing_then() {
        let table = MaterialTable::builtin();
        let objects = [
            ObjectQuery { name: "object_01".into(), volume_m3: 1e-3, ..Default::default() },
            ObjectQuery { name: "floor".into(), ..Default::default() },
        ];
        let mut overrides = Overrides::default();
        for (text, words) in [
            ("object_01", ["--set object_01", "OBJECT.KEY=VALUE"]),
            ("object_01=3", ["--set object_01=3", "OBJECT.KEY=VALUE"]),
            ("object_9.friction=0.3", ["object_9", "object_01, floor"]),
            ("object_01.frition=0.3", ["frition", "friction"]),
            ("object_01.class=stone", ["stone", "marble"]),
            ("object_01.friction=much", ["much", "best,low,high"]),
            ("floor.mass_kg=3", ["floor", "no mass"]),
        ] {
            let message = set(&mut overrides, text, &objects, &table).unwrap_err().to_string();
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        }
        assert!(overrides.object.is_empty());
        set(&mut overrides, "object_01.friction=0.4,0.3,0.5", &objects, &table).unwrap();
        set(&mut overrides, "object_01.class = steel", &objects, &table).unwrap();
        let message = unset(&mut overrides, "object_01.density", &objects).unwrap_err().to_string();
        assert!(message.contains("density is not set"), "{message}");
        assert!(unset(&mut overrides, "object_7", &objects).unwrap_err().to_string().contains("object_01"));
        unset(&mut overrides, "object_01.friction", &objects).unwrap();
        assert_eq!(overrides.object["object_01"].class.as_deref(), Some("steel"));
        unset(&mut overrides, "object_01", &objects).unwrap();
        assert!(overrides.object.is_empty());
    }

    #[test]
    fn the_list_has_every_value_with_its_interval_and_source() {
        let objects = [ObjectQuery {
            name: "m".into(),
            description: "mug".into(),
            volume_m3: 4e-4,
            ..Default::default()
        }];
        let materials = assign(&objects, &MaterialTable::builtin(), None, &Warnings::new()).unwrap();
        let text = listing(&objects, &materials);
        assert!(text.starts_with("m (mug): ceramic\n"), "{text}");
        for words in ["2400", "[2000 – 2700]", "kg/m³", "table", "fill_factor", "0.375", "7e10", "0.36"] {
            assert!(text.contains(words), "{words}: {text}");
        }
        assert_eq!(text.lines().count(), 9);
        let m = metrics(&objects, &materials);
        assert_eq!(m.number("materials.m.density_low"), Some(2000.0));
        assert!((m.number("materials.m.mass_kg").unwrap() - 0.36).abs() < 1e-9);
    }
}
