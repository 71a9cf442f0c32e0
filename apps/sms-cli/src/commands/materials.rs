//! `sms materials`: lists and edits the materials of the objects.

use crate::cli::MaterialsArguments;
use sms_cli::front::Console;
use sms_core::{Material, shell_argument};
use sms_materials::ObjectQuery;
use sms_pipeline::{Run, material_properties, source_name};

pub(crate) fn run(console: &Console, a: &MaterialsArguments) -> anyhow::Result<()> {
    let found = Run::new(&a.run, &console.context).materials(&a.set, &a.unset)?;
    found.unusual.iter().for_each(|warning| console.warn(warning));
    if console.json {
        return console.print_json(&found.metrics());
    }
    if !found.objects.is_empty() {
        console.say(listing(found.shown()));
    }
    if !a.set.is_empty() || !a.unset.is_empty() {
        console.say(format!("  in {}", found.edits.display()));
    }
    if !found.unused.is_empty() {
        console.say(format!(
            "the scene has no body {}: `sms materials {} --unset {}` removes these values",
            found.unused.join(", "),
            shell_argument(&a.run),
            found.unused.join(" --unset ")
        ));
    }
    if !found.changed.is_empty() {
        console.say(format!(
            "the current scene has other values for {}: run `{}` to rebuild it with these",
            found.changed.join(", "),
            found.rebuild
        ));
    }
    Ok(())
}

/// Formats a table with one line per value.
fn listing<'a>(objects: impl Iterator<Item = (&'a ObjectQuery, &'a Material)>) -> String {
    let mut out = String::new();
    for (object, material) in objects {
        let called = object.estimate.as_ref().map_or(&object.description, |e| &e.label);
        let called =
            if called.is_empty() || *called == object.name { String::new() } else { format!(" ({called})") };
        out.push_str(&format!("{}{called}: {}\n", object.name, material.class));
        for (key, property, unit) in material_properties(material) {
            let v = property.value;
            let (best, range) = (number(v.best), format!("[{} – {}]", number(v.low), number(v.high)));
            out.push_str(
                format!("  {key:<18} {best:>10}  {range:<24} {unit:<6} {}", source_name(property)).trim_end(),
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

/// Removes zeros at the end of a decimal fraction.
fn without_zeros(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// Formats a number with four digits.
fn number(x: f64) -> String {
    if x == 0.0 {
        return "0".into();
    }
    if (1e-3..1e5).contains(&x.abs()) {
        let decimals = (3 - x.abs().log10().floor() as i32).clamp(0, 6) as usize;
        return without_zeros(&format!("{x:.decimals$}")).to_owned();
    }
    let text = format!("{x:.3e}");
    text.split_once('e').map_or_else(|| text.clone(), |(m, power)| format!("{}e{power}", without_zeros(m)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Warnings;
    use sms_materials::{MaterialTable, assign};

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
    fn the_list_has_every_value_with_its_interval_and_source() {
        let objects = [ObjectQuery {
            name: "m".into(),
            description: "mug".into(),
            volume_m3: 4e-4,
            ..Default::default()
        }];
        let materials = assign(&objects, &MaterialTable::builtin(), None, &Warnings::new()).unwrap();
        let text = listing(objects.iter().zip(&materials));
        assert!(text.starts_with("m (mug): ceramic\n"), "{text}");
        for words in ["2400", "[2000 – 2700]", "kg/m³", "table", "fill_factor", "0.375", "7e10", "0.36"] {
            assert!(text.contains(words), "{words}: {text}");
        }
        assert_eq!(text.lines().count(), 9);
    }
}
