//! Parser of numbers with units as people write them, converted to SI units. Ambiguous text is refused with the
//! reason, so that a repair can be requested.

use crate::node::ReplyNode;
use crate::property::EstimatedProperty;
use sms_core::Interval;

/// One quantity of a reply: a best value and its ends, if given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Quantity {
    pub best: f64,
    pub ends: Option<(f64, f64)>,
    /// Whether it has an explicit unit, so that its magnitude needs no plausibility check.
    pub has_unit: bool,
}

/// The numbers and the unit of one text.
#[derive(Debug, PartialEq)]
struct Written {
    numbers: Numbers,
    unit: String,
}

#[derive(Debug, PartialEq)]
enum Numbers {
    One(f64),
    Range(f64, f64),
    PlusMinus(f64, f64),
}

/// Parses the value of a property's key. `unit_of_key` is the unit in the key itself, if any.
pub(crate) fn quantity(
    p: EstimatedProperty,
    node: &ReplyNode,
    unit_of_key: Option<&str>,
) -> Result<Quantity, String> {
    match node {
        ReplyNode::Number(text) => {
            let value = finite(text).ok_or_else(|| format!("`{text}` is no finite number"))?;
            let (factor, has_unit) = factor(p, unit_of_key.unwrap_or_default())?;
            Ok(Quantity { best: value * factor, ends: None, has_unit })
        }
        ReplyNode::Text(text) => written_quantity(p, text, unit_of_key),
        ReplyNode::List(items) => list_quantity(p, items, unit_of_key),
        ReplyNode::Map(entries) => map_quantity(p, entries, unit_of_key),
        ReplyNode::Null => Err("it is missing".to_owned()),
        ReplyNode::Bool(_) => Err("it is true or false where a number is needed".to_owned()),
    }
}

fn written_quantity(p: EstimatedProperty, text: &str, unit_of_key: Option<&str>) -> Result<Quantity, String> {
    let written = read(text)?;
    let unit = if written.unit.is_empty() { unit_of_key.unwrap_or_default() } else { &written.unit };
    let (factor, has_unit) = factor(p, unit)?;
    let (best, ends) = match written.numbers {
        Numbers::One(x) => (x, None),
        Numbers::Range(low, high) if low <= high => (0.5 * (low + high), Some((low, high))),
        Numbers::Range(low, high) => return Err(format!("the range {low} to {high} is upside down")),
        Numbers::PlusMinus(x, d) => (x, Some((x - d.abs(), x + d.abs()))),
    };
    Ok(Quantity { best: best * factor, ends: ends.map(|(l, h)| (l * factor, h * factor)), has_unit })
}

/// Two numbers are the ends, three have the best value in the middle; order does not matter.
fn list_quantity(
    p: EstimatedProperty,
    items: &[ReplyNode],
    unit_of_key: Option<&str>,
) -> Result<Quantity, String> {
    let mut values = Vec::new();
    let mut has_unit = !items.is_empty();
    for item in items.iter().take(4) {
        match quantity(p, item, unit_of_key)? {
            Quantity { best, ends: None, has_unit: own } => {
                values.push(best);
                has_unit &= own;
            }
            _ => return Err("a list of ranges cannot be read".to_owned()),
        }
    }
    values.sort_by(f64::total_cmp);
    match values[..] {
        [value] => Ok(Quantity { best: value, ends: None, has_unit }),
        [low, high] => Ok(Quantity { best: 0.5 * (low + high), ends: Some((low, high)), has_unit }),
        [low, best, high] => Ok(Quantity { best, ends: Some((low, high)), has_unit }),
        _ => Err(format!("a list of {} cannot be read; give best, low and high", items.len())),
    }
}

fn map_quantity(
    p: EstimatedProperty,
    entries: &[(String, ReplyNode)],
    unit_of_key: Option<&str>,
) -> Result<Quantity, String> {
    let (mut best, mut low, mut high, mut unit, mut range) = (None, None, None, None, None);
    for (key, node) in entries {
        let slot = match plain(key).as_str() {
            "best" | "value" | "estimate" | "nominal" | "mean" | "typical" | "bestestimate" | "number"
            | "mid" | "median" | "expected" | "amount" => &mut best,
            "low" | "min" | "minimum" | "lower" | "lowerbound" | "from" | "lo" => &mut low,
            "high" | "max" | "maximum" | "upper" | "upperbound" | "to" | "hi" => &mut high,
            "unit" | "units" => &mut unit,
            "range" | "interval" | "bounds" => &mut range,
            _ => continue,
        };
        if slot.replace(node).is_some_and(|earlier| earlier != node) {
            return Err(format!("`{key}` is given twice, differently"));
        }
    }
    let unit = match unit {
        Some(ReplyNode::Text(text)) if !text.trim().is_empty() => Some(text.as_str()),
        _ => unit_of_key,
    };
    let of = |node: Option<&ReplyNode>| match node {
        None | Some(ReplyNode::Null) => Ok(None),
        Some(ReplyNode::Map(_)) => Err("objects in objects in objects cannot be read".to_owned()),
        Some(node) => quantity(p, node, unit).map(Some),
    };
    let ends = match (of(low)?, of(high)?, of(range)?) {
        (Some(l), Some(h), _) => Some((l.best, h.best)),
        (_, _, Some(Quantity { ends: Some(ends), .. })) => Some(ends),
        _ => None,
    };
    match (of(best)?, ends) {
        (Some(best), ends) => Ok(Quantity { ends: ends.or(best.ends), ..best }),
        (None, Some((low, high))) if low <= high => {
            Ok(Quantity { best: 0.5 * (low + high), ends: Some((low, high)), has_unit: unit.is_some() })
        }
        _ => Err("it has no best value".to_owned()),
    }
}

/// Returns a word without case, spaces and signs, for comparing keys.
pub(crate) fn plain(text: &str) -> String {
    text.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Returns the factor of a written unit, and whether there is a unit. Without one, SI is assumed.
fn factor(p: EstimatedProperty, unit: &str) -> Result<(f64, bool), String> {
    let unit = unit.trim();
    if unit.is_empty() {
        return Ok((1.0, false));
    }
    let known = match p {
        EstimatedProperty::Density => density_unit(unit),
        EstimatedProperty::YoungsModulus => pressure_unit(unit),
        _ => share_unit(p, unit),
    };
    known
        .map(|f| (f, true))
        .ok_or_else(|| format!("the unit `{}` cannot be read for it", shortened(unit, 30)))
}

/// Whether the end of a key (without signs) is a unit of the property: `kgm3` of `density_kg_m3`.
pub(crate) fn is_unit(p: EstimatedProperty, text: &str) -> bool {
    factor(p, text).is_ok()
}

fn share_unit(p: EstimatedProperty, unit: &str) -> Option<f64> {
    match unit.to_lowercase().as_str() {
        // Friction coefficients and Poisson's ratios are not written in percent.
        "%" | "percent" | "per cent" | "pct" => p.takes_percent().then_some(0.01),
        "-" | "–" | "1" | "dimensionless" | "unitless" | "none" | "n/a" | "ratio" | "fraction"
        | "coefficient" => Some(1.0),
        _ => None,
    }
}

/// Normalizes a unit: `kg·m⁻³`, `kg / m^3` and `kg per m3` become `kg/m3`.
fn normal_unit(unit: &str) -> String {
    let mut text = unit.to_lowercase();
    for (from, to) in [
        ("⁻³", "-3"),
        ("⁻²", "-2"),
        ("³", "3"),
        ("²", "2"),
        ("−", "-"),
        ("^", ""),
        ("**", ""),
        (" per ", "/"),
        ("cubic ", "cubic"),
        ("square ", "square"),
        ("metres", "meter"),
        ("meters", "meter"),
        ("metre", "meter"),
        ("grammes", "gram"),
        ("litres", "liter"),
        ("litre", "liter"),
        ("liters", "liter"),
        ("kilograms", "kg"),
        ("kilogram", "kg"),
        ("grams", "gram"),
        ("gram", "g"),
        ("cubiccentimeter", "cm3"),
        ("cubicmeter", "m3"),
        ("cubicdecimeter", "dm3"),
        ("cubicfoot", "ft3"),
        ("cubicinch", "in3"),
        ("squaremeter", "m2"),
        ("squaremillimeter", "mm2"),
        ("milliliter", "ml"),
        ("liter", "l"),
        ("tonnes", "t"),
        ("tonne", "t"),
        ("pounds", "lb"),
        ("lbs", "lb"),
        ("newtons", "n"),
        ("newton", "n"),
    ] {
        text = text.replace(from, to);
    }
    text.chars()
        .filter(|c| !c.is_whitespace() && !matches!(c, '·' | '*' | '.' | '(' | ')' | '[' | ']'))
        .collect()
}

fn density_unit(unit: &str) -> Option<f64> {
    Some(match normal_unit(unit).as_str() {
        "kg/m3" | "kgm-3" | "kgm3" | "g/l" | "mg/cm3" | "g/dm3" | "mg/ml" => 1.0,
        "g/cm3" | "g/cc" | "gcm-3" | "gcm3" | "g/ml" | "kg/l" | "kg/dm3" | "t/m3" | "mg/mm3" | "gpercc" => {
            1000.0
        }
        "kg/cm3" => 1e6,
        "lb/ft3" | "pcf" => 16.018_463,
        "lb/in3" => 27_679.905,
        "oz/in3" => 1_729.994,
        _ => return None,
    })
}

fn pressure_unit(unit: &str) -> Option<f64> {
    Some(match normal_unit(unit).as_str() {
        "pa" | "pascal" | "pascals" | "n/m2" | "nm-2" => 1.0,
        "kpa" | "kilopascal" | "kilopascals" => 1e3,
        // Moduli are not given in millipascal.
        "mpa" | "megapascal" | "megapascals" | "n/mm2" | "nmm-2" | "mn/m2" => 1e6,
        "gpa" | "gigapascal" | "gigapascals" | "kn/mm2" | "gn/m2" => 1e9,
        "tpa" => 1e12,
        "bar" => 1e5,
        "psi" => 6_894.757,
        "ksi" => 6_894_757.0,
        "msi" | "mpsi" => 6.894_757e9,
        _ => return None,
    })
}

fn finite(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|x| x.is_finite())
}

/// Words and signs before a number, the longer ones first.
const APPROXIMATELY: &str = "approximately approx. approx roughly around about circa ca. ~ ≈ =";

/// Splits a text into its numbers and its unit: `about 2,400 kg/m³`, `7×10^10 Pa`, `0.3–0.5`, `2400 ± 200 kg/m3`.
fn read(text: &str) -> Result<Written, String> {
    let refuse = || format!("`{}` cannot be read as a number with a unit", shortened(text, 40));
    let mut rest = text.trim();
    loop {
        let lower = rest.to_lowercase();
        let Some(word) = APPROXIMATELY.split(' ').find(|w| lower.starts_with(w)) else { break };
        rest = rest.get(word.len()..).ok_or_else(refuse)?.trim_start();
    }
    if rest.starts_with(['<', '>', '≤', '≥']) {
        return Err(format!("`{}` is a bound where an estimate is needed", shortened(text, 40)));
    }
    let (first, after) = leading_number(rest).ok_or_else(refuse)?;
    let after = after.trim_start();
    // `2.4 g/cm3 - 2.6 g/cm3`: the first unit may precede the sign of a range.
    let (early_unit, tail) = split_at_range(after);
    let (numbers, unit) = match tail {
        None => (Numbers::One(first), after),
        Some((numbers, tail)) => {
            let (second, unit) = leading_number(tail.trim_start()).ok_or_else(refuse)?;
            let unit = unit.trim();
            if !early_unit.is_empty() && !unit.is_empty() && normal_unit(early_unit) != normal_unit(unit) {
                return Err(format!("`{}` mixes units", shortened(text, 40)));
            }
            (numbers(first, second), if unit.is_empty() { early_unit } else { unit })
        }
    };
    let unit = unit.trim().trim_end_matches(['.', ',', ';']).trim();
    let unit = unit.strip_prefix('(').and_then(|u| u.strip_suffix(')')).unwrap_or(unit);
    if unit.chars().any(|c| c.is_ascii_digit()) && unit.starts_with(|c: char| c.is_ascii_digit()) {
        return Err(refuse());
    }
    Ok(Written { numbers, unit: unit.to_owned() })
}

/// Splits a text at the sign of a range or a tolerance that a number follows; returns the meaning of the two numbers.
fn split_at_range(text: &str) -> (&str, Option<(fn(f64, f64) -> Numbers, &str)>) {
    for sign in ["±", "+/-", "+-", " to ", "–", "—", "-"] {
        let numbers = if matches!(sign, "±" | "+/-" | "+-") { Numbers::PlusMinus } else { Numbers::Range };
        // ` to ` also at the start, where the preceding space has been trimmed.
        let sign_at = text.find(sign).or_else(|| (sign == " to " && text.starts_with("to ")).then_some(0));
        let Some(at) = sign_at else { continue };
        let len = if at == 0 && sign == " to " { 3 } else { sign.len() };
        let tail = &text[at + len..];
        // The minus of `m-3` is part of the unit.
        let before = &text[..at];
        let is_exponent = sign == "-" && before.ends_with(|c: char| c.is_alphabetic() || c == '^');
        if !is_exponent && leading_number(tail.trim_start()).is_some() {
            return (before.trim(), Some((numbers, tail)));
        }
    }
    (text, None)
}

/// Splits off the leading number of a text: `-1.5e3`, `2,400`, `0,35`, `7×10^10`, `7 x 10¹⁰`, but not `½`.
fn leading_number(text: &str) -> Option<(f64, &str)> {
    let end = text
        .char_indices()
        .find(|&(i, c)| {
            !(c.is_ascii_digit() || matches!(c, '.' | ',') || (i == 0 && matches!(c, '-' | '+' | '−')))
        })
        .map_or(text.len(), |(i, _)| i);
    let mut digits = &text[..end];
    // A full stop or comma at the end of a sentence is not part of the number.
    while let Some(shorter) = digits.strip_suffix([',', '.']) {
        digits = shorter;
    }
    let mut value = decimal(&digits.replace('−', "-"))?;
    let mut rest = &text[digits.len()..];
    if let Some(exponent) = rest.strip_prefix(['e', 'E']) {
        let end = exponent
            .char_indices()
            .find(|&(i, c)| !(c.is_ascii_digit() || (i == 0 && matches!(c, '-' | '+'))))
            .map_or(exponent.len(), |(i, _)| i);
        if exponent[..end].contains(|c: char| c.is_ascii_digit()) {
            value = finite(&format!("{value}e{}", &exponent[..end]))?;
            rest = &exponent[end..];
        }
    } else if let Some((power, after)) = power_of_ten(rest) {
        value = finite(&format!("{value}e{power}"))?;
        rest = after;
    }
    value.is_finite().then_some((value, rest))
}

/// `×10^9`, `x 10⁹`, `*10**9`, `· 10^{9}`.
fn power_of_ten(text: &str) -> Option<(i32, &str)> {
    let text = text.trim_start();
    let text = text.strip_prefix(['×', 'x', 'X', '*', '·', '⋅'])?.trim_start().strip_prefix("10")?;
    let lowered = |c: char| "⁰¹²³⁴⁵⁶⁷⁸⁹⁻".chars().zip("0123456789-".chars()).find(|pair| pair.0 == c);
    let raised: String = text.chars().map_while(lowered).map(|pair| pair.1).collect();
    if !raised.is_empty() {
        let bytes: usize = text.chars().take(raised.chars().count()).map(char::len_utf8).sum();
        return Some((raised.parse().ok().filter(|p: &i32| p.abs() < 400)?, &text[bytes..]));
    }
    let text = text.strip_prefix("**").or_else(|| text.strip_prefix('^'))?;
    let (braced, text) = match text.strip_prefix(['{', '(']) {
        Some(inner) => (true, inner),
        None => (false, text),
    };
    let end = text
        .char_indices()
        .find(|&(i, c)| !(c.is_ascii_digit() || (i == 0 && matches!(c, '-' | '+'))))
        .map_or(text.len(), |(i, _)| i);
    let power: i32 = text[..end].parse().ok().filter(|p: &i32| p.abs() < 400)?;
    let rest = &text[end..];
    Some((power, if braced { rest.strip_prefix(['}', ')'])? } else { rest }))
}

/// Parses a decimal number with a point or a comma. `2,400` is two thousand four hundred; `0,35` and `2,4` have a
/// decimal comma; ambiguous text (`1.200,5`) is refused.
fn decimal(text: &str) -> Option<f64> {
    if !text.contains(',') {
        return finite(text);
    }
    let (sign, digits) = match text.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = match digits.split_once('.') {
        Some((whole, fraction)) if !fraction.contains(',') => (whole, Some(fraction)),
        Some(_) => return None,
        None => (digits, None),
    };
    let groups: Vec<&str> = whole.split(',').collect();
    let is_grouped = groups.len() > 1
        && (1..=3).contains(&groups[0].len())
        && !groups[0].starts_with('0')
        && groups[1..].iter().all(|g| g.len() == 3);
    if is_grouped {
        return finite(&format!("{}.{}", groups.concat(), fraction.unwrap_or("0"))).map(|x| sign * x);
    }
    match (groups.len(), fraction) {
        (2, None) => finite(&format!("{}.{}", groups[0], groups[1])).map(|x| sign * x),
        _ => None,
    }
}

/// Returns the first characters of a text, for messages.
pub(crate) fn shortened(text: &str, most: usize) -> String {
    let text = text.trim();
    match text.char_indices().nth(most) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// Returns the quantity as an interval that contains its best value, or the fault in it.
pub(crate) fn interval(p: EstimatedProperty, q: Quantity) -> Result<Interval, String> {
    p.check(q.best, q.has_unit)?;
    let Some((low, high)) = q.ends else { return Ok(p.widened(q.best)) };
    if !(low.is_finite() && high.is_finite()) || low > high {
        return Err(format!("its low end {low} is above its high end {high}"));
    }
    if q.best < low || q.best > high {
        return Err(format!("its best value {} is outside its own range {low} to {high}", q.best));
    }
    let (least, most) = p.range();
    if low < least || high > most {
        return Err(format!("its range {low} to {high} leaves what is possible, {least} to {most}"));
    }
    // An estimate from a picture has some width: coincident ends count as missing.
    if high - low <= 1e-3 * q.best.abs() {
        Ok(p.widened(q.best))
    } else {
        Ok(Interval::new(q.best, low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use EstimatedProperty::{Density, FillFactor, Friction, PoissonsRatio, Restitution, YoungsModulus};

    fn read_text(p: EstimatedProperty, text: &str) -> Result<f64, String> {
        quantity(p, &ReplyNode::Text(text.into()), None).map(|q| q.best)
    }

    #[test]
    fn units_come_to_si() {
        for (p, text, si) in [
            (Density, "2400", 2400.0),
            (Density, "2.4 g/cm3", 2400.0),
            (Density, "2.4g/cm³", 2400.0),
            (Density, "2.4 g/cc", 2400.0),
            (Density, "2400 kg/m^3", 2400.0),
            (Density, "2400 kg·m⁻³", 2400.0),
            (Density, "2400 kg m-3", 2400.0),
            (Density, "2,400 kg per cubic meter", 2400.0),
            (Density, "2.4 grams per cubic centimetre", 2400.0),
            (Density, "2,4 g/ml", 2400.0),
            (Density, "62.4 lb/ft3", 999.552_091),
            (Density, "~ 2400 kg/m³.", 2400.0),
            (Density, "approximately 2400 (kg/m3)", 2400.0),
            (YoungsModulus, "70 GPa", 7e10),
            (YoungsModulus, "2500 MPa", 2.5e9),
            (YoungsModulus, "2500 N/mm²", 2.5e9),
            (YoungsModulus, "7×10^10 Pa", 7e10),
            (YoungsModulus, "7 x 10¹⁰ Pa", 7e10),
            (YoungsModulus, "7e10", 7e10),
            (YoungsModulus, "7.0E+10 pascal", 7e10),
            (YoungsModulus, "10 Msi", 6.894_757e10),
            (Restitution, "60 %", 0.6),
            (Restitution, "60%", 0.6),
            (FillFactor, "20 percent", 0.2),
            (Friction, "0,35", 0.35),
            (Friction, "0.35 (dimensionless)", 0.35),
            (PoissonsRatio, "about 0.22", 0.22),
        ] {
            let read = read_text(p, text).unwrap_or_else(|e| panic!("{text}: {e}"));
            assert!((read - si).abs() <= 1e-6 * si, "{text}: {read}");
        }
    }

    #[test]
    fn ambiguous_quantities_are_refused() {
        for (p, text) in [
            (Density, "heavy"),
            (Density, ""),
            (Density, "2400 kg"),
            (Density, "2.4 SG"),
            (Density, "1.200,5"),
            (Density, "> 2000"),
            (Density, "NaN"),
            (Density, "1e400"),
            (Density, "2400 2500"),
            (Density, "2.4 g/cm3 - 2600 kg/m3"),
            (Density, "2600-2400"),
            (YoungsModulus, "70 GPa/m"),
            (YoungsModulus, "70 kg/m3"),
            (Friction, "40 %"),
            (PoissonsRatio, "22%"),
            (Friction, "0.4 N"),
        ] {
            assert!(read_text(p, text).is_err(), "{text}");
        }
    }

    #[test]
    fn ranges_in_every_form_have_their_ends() {
        let ends = |p: EstimatedProperty, node: ReplyNode| quantity(p, &node, None).map(|q| (q.best, q.ends));
        let text = |t: &str| ReplyNode::Text(t.into());
        for t in [
            "2400-2600 kg/m3",
            "2400–2600",
            "2400 to 2600 kg/m³",
            "2.4 g/cm3 - 2.6 g/cm3",
            "2500 ± 100 kg/m3",
        ] {
            let (best, range) = ends(Density, text(t)).unwrap();
            let (low, high) = range.unwrap();
            assert!(
                (best - 2500.0).abs() < 1e-9 && (low - 2400.0).abs() < 1e-9 && (high - 2600.0).abs() < 1e-9,
                "{t}"
            );
        }
        let n = |t: &str| ReplyNode::Number(t.into());
        let list = ReplyNode::List(vec![n("2500"), n("2400"), n("2600")]);
        assert_eq!(ends(Density, list).unwrap(), (2500.0, Some((2400.0, 2600.0))));
        let map = |entries: &[(&str, ReplyNode)]| {
            ReplyNode::Map(entries.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect())
        };
        let given = map(&[
            ("value", n("2.5")),
            ("min", n("2.4")),
            ("max", text("2600 kg/m3")),
            ("unit", text("g/cm^3")),
        ]);
        assert_eq!(ends(Density, given).unwrap(), (2500.0, Some((2400.0, 2600.0))));
        let given = map(&[("best", n("2500")), ("range", ReplyNode::List(vec![n("2400"), n("2600")]))]);
        assert_eq!(ends(Density, given).unwrap(), (2500.0, Some((2400.0, 2600.0))));
        assert!(ends(Density, map(&[("low", n("1"))])).is_err());
        assert!(ends(Density, map(&[("best", n("1")), ("Best", n("2"))])).is_err());
    }

    #[test]
    fn the_keys_unit_counts_where_the_value_has_none() {
        let q = quantity(Density, &ReplyNode::Number("2.4".into()), Some("g/cm3")).unwrap();
        assert_eq!((q.best, q.has_unit), (2400.0, true));
        let q = quantity(Density, &ReplyNode::Text("2400 kg/m3".into()), Some("g/cm3")).unwrap();
        assert_eq!(q.best, 2400.0, "the value's own unit is nearer");
    }

    #[test]
    fn intervals_hold_their_best_value_and_stay_possible() {
        let of = |p: EstimatedProperty, best: f64, ends: Option<(f64, f64)>| {
            interval(p, Quantity { best, ends, has_unit: true })
        };
        assert_eq!(of(Friction, 0.4, Some((0.3, 0.5))), Ok(Interval::new(0.4, 0.3, 0.5)));
        for ends in [None, Some((0.4, 0.4))] {
            let widened = of(Friction, 0.4, ends).unwrap();
            assert!(widened.low < 0.3 && widened.high > 0.5, "{widened:?}");
        }
        assert!(of(Friction, 0.4, Some((0.5, 0.3))).is_err());
        assert!(of(Friction, 0.4, Some((0.5, 0.6))).is_err());
        assert!(of(Restitution, 0.9, Some((0.8, 1.2))).is_err());
    }
}
