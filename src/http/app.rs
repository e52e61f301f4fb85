//! What all calls share: the buses, the director, the events. All of it is handed out by reference; what changes belongs
//! to the buses' tasks and to the director.

use std::net::SocketAddr;
use std::sync::Arc;

use tokio::sync::{broadcast, mpsc};

use super::director::Order;
use super::error::ApiError;
use super::events::Told;
use crate::bus::Bus;
use crate::config::Control;
use crate::io::BusHandle;
use crate::journal::Known;
use crate::station::Station;
use crate::time::Instant;

/// What all calls share.
#[derive(Clone)]
pub struct App(Arc<Shared>);

/// See [`App`].
pub struct Shared {
    /// The buses, in the order of devices.toml.
    pub buses: Vec<Line>,
    /// Changes of clocks, snapshots and numbers of faults go one after the other through it.
    pub director: mpsc::Sender<Order>,
    /// What happens on the buses, for those who follow it.
    pub events: broadcast::Sender<Told>,
    /// Where it listens.
    pub listen: SocketAddr,
    /// Who may ask (CTL-1).
    pub control: Control,
}

impl std::ops::Deref for App {
    type Target = Shared;

    fn deref(&self) -> &Shared {
        &self.0
    }
}

/// A bus as calls see it.
#[derive(Clone, Debug)]
pub struct Line {
    /// The way to its task.
    pub handle: BusHandle,
    /// Its devices, in the order of devices.toml, with the units that they had at the start.
    pub devices: Vec<Known>,
}

impl Line {
    /// Lets the bus' task do something.
    ///
    /// # Errors
    /// The bus has ended.
    pub async fn call<R: Send + 'static>(
        &self,
        act: impl FnOnce(&mut Bus, Instant) -> R + Send + 'static,
    ) -> Result<R, ApiError> {
        let ended = || ApiError::unavailable(format!("the bus {} has ended", self.handle.name));
        self.handle.call(act).await.ok_or_else(ended)
    }

    /// Its stations as they are now.
    ///
    /// # Errors
    /// The bus has ended.
    pub async fn stations(&self) -> Result<Vec<Station>, ApiError> {
        let mut stations = Vec::new();
        for index in 0..self.devices.len() {
            // One at a time, so that requests come in between.
            stations.push(self.station(index).await?);
        }
        Ok(stations)
    }

    /// One of its stations as it is now.
    ///
    /// # Errors
    /// The bus has ended.
    pub async fn station(&self, index: usize) -> Result<Station, ApiError> {
        self.call(move |bus, now| {
            bus.live_to(now);
            bus.stations()[index].clone()
        })
        .await
    }
}

impl App {
    /// What all calls share.
    pub fn new(shared: Shared) -> Self {
        Self(Arc::new(shared))
    }

    /// The bus of that name.
    ///
    /// # Errors
    /// There is none.
    pub fn bus(&self, name: &str) -> Result<(usize, &Line), ApiError> {
        let found = self.buses.iter().position(|line| line.handle.name == name);
        let names = self.buses.iter().map(|line| line.handle.name.as_str());
        let index = found.ok_or_else(|| ApiError::none_of("bus", name, names))?;
        Ok((index, &self.buses[index]))
    }

    /// The bus of a device and the device's index on it.
    ///
    /// # Errors
    /// There is no device of that name.
    pub fn device(&self, name: &str) -> Result<(&Line, usize), ApiError> {
        let found = self.buses.iter().find_map(|line| {
            let index = line.devices.iter().position(|device| device.name == name)?;
            Some((line, index))
        });
        let names = self.buses.iter().flat_map(|line| line.devices.iter().map(|device| device.name.as_str()));
        found.ok_or_else(|| ApiError::none_of("device", name, names))
    }
}
