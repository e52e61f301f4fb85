//! A configuration in words, as `standin check` prints it.

use std::fmt::Write;

use crate::bus::{LineCheck, Timing};

use super::{Config, Start};

impl Config {
    /// What would run, in lines for people.
    pub fn plan(&self) -> String {
        let mut plan = String::new();
        let start = match self.start {
            Start::Host => "the host's time".into(),
            Start::At(time) => time.to_string(),
        };
        let _ = writeln!(plan, "clock    from {start} on, {} times as fast as real time", self.rate);
        let memory = self.state.as_ref().map(|folder| format!("in the folder {}", folder.display()));
        let _ = writeln!(plan, "memory   {}", memory.as_deref().unwrap_or("as long as the program runs"));
        let control = self.control.as_ref().map(|control| {
            let token = if control.token.is_some() { ", with a token" } else { "" };
            format!("http://{}{token}", control.listen)
        });
        let _ = writeln!(plan, "control  {}", control.as_deref().unwrap_or("none"));
        let (name_width, model_width) = self.widths();
        for bus in &self.buses {
            let settings = bus.settings;
            let timing = match settings.timing {
                Timing::Fast => "fast",
                Timing::Wire => "wire",
            };
            let check = match settings.line_check {
                LineCheck::Warn => "warn",
                LineCheck::Enforce => "enforce",
                LineCheck::Off => "off",
            };
            let line = settings.line;
            let _ = writeln!(plan, "\nbus {}: {line}, timing {timing}, line check {check}", bus.name);
            for port in &bus.ports {
                let _ = writeln!(plan, "  {port}");
            }
            for device in &bus.devices {
                let (unit, name, kind) = (device.address.unit, &device.name, device.kind);
                let start_values = match device.registers.len() {
                    0 => String::new(),
                    1 => "  1 start value".into(),
                    count => format!("  {count} start values"),
                };
                let model = kind.name;
                let text = format!("  unit {unit:3}  {name:name_width$}  {model:model_width$}{start_values}");
                let _ = writeln!(plan, "{}", text.trim_end());
            }
        }
        plan
    }

    fn widths(&self) -> (usize, usize) {
        let devices = || self.buses.iter().flat_map(|bus| &bus.devices);
        let name = devices().map(|device| device.name.chars().count()).max();
        let model = devices().map(|device| device.kind.name.len()).max();
        (name.unwrap_or(0), model.unwrap_or(0))
    }
}
