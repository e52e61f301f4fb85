//! The start report: what runs where, for people and, as one line of JSON, for programs.

use std::fmt::Write;

use serde::Serialize;

use super::task::BusHandle;
use crate::bus::Settings;

/// What runs.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Everything listens.
    pub ready: bool,
    /// The buses, in the order of devices.toml.
    pub buses: Vec<BusReport>,
    /// The control interface's URL.
    pub control: Option<String>,
}

/// A bus that runs.
#[derive(Debug, Serialize)]
pub struct BusReport {
    name: String,
    /// Its first port as devices.toml names it, and what a client opens.
    port: String,
    path: String,
    /// All its ports.
    ports: Vec<PortReport>,
    devices: Vec<DeviceReport>,
    #[serde(skip)]
    settings: Settings,
}

#[derive(Clone, Debug, Serialize)]
struct PortReport {
    port: String,
    path: String,
}

/// A device that runs.
#[derive(Debug, Serialize)]
pub struct DeviceReport {
    /// Its name.
    pub name: String,
    /// Its model.
    pub model: &'static str,
    /// The unit that it answers now.
    pub unit: u8,
}

impl BusReport {
    /// A bus and its devices.
    pub fn new(handle: &BusHandle, settings: Settings, devices: Vec<DeviceReport>) -> Self {
        let ports = handle.ports.iter().map(|(port, path)| PortReport { port: port.to_string(), path: path.clone() });
        let ports: Vec<PortReport> = ports.collect();
        let (port, path) = ports.first().map(|first| (first.port.clone(), first.path.clone())).unwrap_or_default();
        Self { name: handle.name.clone(), port, path, ports, devices, settings }
    }
}

impl Report {
    /// One line of JSON.
    pub fn json(&self) -> String {
        // Strings, numbers and lists of them are always JSON.
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }

    /// Lines for people; the last is `ready`.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let width = self.buses.iter().flat_map(|bus| &bus.devices).map(|device| device.name.chars().count()).max();
        let width = width.unwrap_or(0);
        for bus in &self.buses {
            let _ = writeln!(text, "bus {}: {}", bus.name, bus.settings.line);
            for PortReport { port, path } in &bus.ports {
                let kind = port.split_once(':').map_or("port", |(kind, _)| kind);
                let _ = writeln!(text, "  {kind} {path}");
            }
            for DeviceReport { name, model, unit } in &bus.devices {
                let _ = writeln!(text, "  unit {unit:3}  {name:width$}  {model}");
            }
        }
        if let Some(control) = &self.control {
            let _ = writeln!(text, "control {control}");
        }
        text + "ready\n"
    }
}
