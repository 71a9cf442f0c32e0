//! Helpers for HTML text.

use base64::Engine;
use sms_core::{ColorImage, CoreError, escape_xml, write_png_color};
use sms_task::Parameter;
use std::fmt::Write;
use std::path::Path;

/// Encodes bytes for JSON and for `data:` addresses.
pub(crate) fn base64_of(bytes: &[u8]) -> String {
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

/// Writes a picture as PNG; returns it as the address of an image in a page without other files.
pub(crate) fn write_picture(path: &Path, picture: &ColorImage) -> Result<String, CoreError> {
    write_png_color(path, picture)?;
    let bytes = std::fs::read(path).map_err(CoreError::read(path))?;
    Ok(format!("data:image/png;base64,{}", base64_of(&bytes)))
}

/// Returns the table of an action's values and the ranges that were searched.
pub(crate) fn action_table(parameters: &[Parameter], values: &[f64], decimals: usize) -> String {
    let mut html = String::from("<table><tr><th>action</th><th>value</th><th>range searched</th></tr>");
    for (p, value) in parameters.iter().zip(values) {
        let _ = write!(
            html,
            "<tr><td>{}</td><td>{value:.decimals$} {unit}</td><td>{:.3} to {:.3} {unit}</td></tr>",
            escape_xml(&p.name),
            p.low,
            p.high,
            unit = escape_xml(&p.unit)
        );
    }
    html + "</table>"
}
