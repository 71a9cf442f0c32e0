//! `sms devices`: lists the devices for a scan.

use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_gaussians::SimdForm;

pub(crate) fn run(console: &Console) -> anyhow::Result<()> {
    let mut metrics = Metrics::new();
    let form = SimdForm::available().last().map(|form| format!("{form:?}")).unwrap_or_default();
    metrics.set("devices.cpu.kernels", form.clone());
    console.say(format!("cpu      {form} kernels, {} threads", rayon::current_num_threads()));
    gpus(console, &mut metrics);
    if console.json {
        console.print_json(&metrics)?;
    }
    Ok(())
}

#[cfg(feature = "gpu")]
fn gpus(console: &Console, metrics: &mut Metrics) {
    use sms_gaussians_gpu::{AdapterChoice, adapters, self_check};
    let adapters = adapters();
    metrics.set("devices.gpu.count", adapters.len());
    for adapter in &adapters {
        let (sound, text) = match self_check(AdapterChoice::Index(adapter.index)) {
            Err(error) => (false, error.to_string()),
            Ok(check) => match check.fault() {
                Some(fault) => (false, format!("DIFFERS FROM THE CPU: {fault}")),
                None => (true, format!("agrees with the CPU: {check}")),
            },
        };
        let kind = if adapter.software { ", software on the CPU: used only if selected" } else { "" };
        console.say(format!(
            "gpu:{:<4} {} ({}, {}{kind})",
            adapter.index, adapter.name, adapter.backend, adapter.driver
        ));
        console.say(format!("         {text}"));
        let prefix = format!("devices.gpu.{}.", adapter.index);
        metrics.set(format!("{prefix}name"), adapter.name.clone());
        metrics.set(format!("{prefix}software"), adapter.software);
        metrics.set(format!("{prefix}usable"), sound);
        metrics.set(format!("{prefix}self_check"), text);
    }
    if adapters.is_empty() {
        console.say("no GPU was found");
    }
}

#[cfg(not(feature = "gpu"))]
fn gpus(console: &Console, metrics: &mut Metrics) {
    metrics.set("devices.gpu.count", 0);
    console.say("this program was built without GPU support (`--features gpu`)");
}
