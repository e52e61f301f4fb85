//! Starts everything that a configuration names, serves it, and ends it in order.

use std::collections::HashMap;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::os::unix::process::parent_id;
use std::sync::Arc;
use std::time::Duration;

use nix::libc;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::{JoinError, JoinSet};
use tracing::{info, warn};

use super::clock::RealClock;
use super::report::{BusReport, DeviceReport, Report};
use super::task::{BusHandle, BusTask, Watcher};
use super::trace;
use crate::bus::{Bus, Output};
use crate::config::{BusConfig, Config, Control};
use crate::http::Server;
use crate::image::Layout;
use crate::station::{Setup, Station};
use crate::store::{Store, StoreError};
use crate::time::SimClock;

/// How a configuration is run, beside what it says itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunOptions {
    /// Print every frame on stderr.
    pub trace: bool,
    /// Print the start report as one line of JSON.
    pub json: bool,
    /// End when the process that started this one does.
    pub exit_with_parent: bool,
}

/// Why a configuration cannot be run, or not any longer.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A port cannot be opened.
    #[error("bus {bus}: {port}: {source}")]
    Port {
        /// The bus.
        bus: String,
        /// The port, as devices.toml names it.
        port: String,
        /// Why.
        source: io::Error,
    },
    /// A device cannot start.
    #[error("{device}: {}", problems.join("; "))]
    Device {
        /// Its name.
        device: String,
        /// What is wrong, a line each.
        problems: Vec<String>,
    },
    /// The control interface cannot listen.
    #[error("[control] listen = \"{listen}\": {source}")]
    Control {
        /// Where it was to listen.
        listen: SocketAddr,
        /// Why.
        source: io::Error,
    },
    /// Memory cannot be kept or read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The system refuses something.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: &'static str,
        /// Why it failed.
        source: io::Error,
    },
    /// The end was cut short: what was being answered or written may not be whole.
    #[error("ended without waiting for everything: {why}")]
    Early {
        /// Why.
        why: &'static str,
    },
    /// A bus has ended by itself.
    #[error("bus {bus} has failed: {reason}")]
    Bus {
        /// Its name.
        bus: String,
        /// Why.
        reason: String,
    },
}

/// How often the parent is looked for.
const PARENT_EVERY: Duration = Duration::from_millis(200);

/// How long the buses may take to end: answers under way, a disk that is slow.
const END_WITHIN: Duration = Duration::from_secs(10);

/// Runs a configuration until a signal ends it. When this returns, memory is kept and no link is left.
///
/// # Errors
/// What cannot be started, in which case nothing is, or what has failed since.
pub fn run(config: Config, options: RunOptions) -> Result<(), RunError> {
    let parent = parent_id();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| RunError::System { what: "the program cannot start", source })?;
    let result = runtime.block_on(async {
        let mut ends = Ends::new(options.exit_with_parent.then_some(parent))?;
        let bench = Bench::start(&config, options)?;
        bench.serve(&mut ends).await
    });
    // An image that a stuck disk does not take must not keep the program from ending.
    runtime.shutdown_background();
    result
}

/// What ends the program.
struct Ends {
    signals: [Signal; 3],
    parent: Option<u32>,
    /// Writing to a file above a size limit is an error to be answered (BUS-19), not the death that its signal brings.
    _file_size: Signal,
}

impl Ends {
    fn new(parent: Option<u32>) -> Result<Self, RunError> {
        let listen = |kind: SignalKind| {
            signal(kind).map_err(|source| RunError::System { what: "signals cannot be caught", source })
        };
        Ok(Self {
            signals: [
                listen(SignalKind::interrupt())?,
                listen(SignalKind::terminate())?,
                listen(SignalKind::hangup())?,
            ],
            parent,
            _file_size: listen(SignalKind::from_raw(libc::SIGXFSZ))?,
        })
    }

    async fn signal(&mut self) {
        let [interrupt, terminate, hangup] = &mut self.signals;
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => {}
        }
    }

    /// Comes when a signal asks for the end, or the parent is gone.
    async fn come(&mut self) {
        let Some(parent) = self.parent else { return self.signal().await };
        // The kernel's own death signal would come when the thread that started this process ends, and test runners
        // start processes from threads.
        let gone = async {
            while parent_id() == parent {
                tokio::time::sleep(PARENT_EVERY).await;
            }
        };
        tokio::select! {
            () = self.signal() => {}
            () = gone => info!("the process that started this one has ended"),
        }
    }
}

/// Everything that runs.
struct Bench {
    handles: Vec<BusHandle>,
    tasks: JoinSet<io::Result<()>>,
    names: HashMap<tokio::task::Id, String>,
}

impl Bench {
    /// Starts the buses and prints the start report. What fails on the way takes back what was started before it.
    fn start(config: &Config, options: RunOptions) -> Result<Self, RunError> {
        let clock = RealClock::start();
        let sim = config.clock(chrono::Local::now().naive_local());
        let store = config.state.as_deref().map(Store::open).transpose()?.map(Arc::new);
        let mut layouts = HashMap::new();
        let mut buses = Vec::new();
        for plan in &config.buses {
            let stations = plan.devices.iter().map(|setup| {
                let layout = layouts.entry(setup.kind.name).or_insert_with(|| Arc::new(Layout::new(setup.kind.map)));
                station(setup, layout.clone(), store.as_deref(), &sim)
            });
            let stations = stations.collect::<Result<Vec<Station>, RunError>>()?;
            buses.push(Bus::new(plan.name.clone(), plan.settings, sim.clone(), stations));
        }
        if let Some(store) = &store {
            for bus in &mut buses {
                keep_first(bus, store)?;
            }
        }
        let bind = |control: &Control| {
            Server::bind(control).map_err(|source| RunError::Control { listen: control.listen, source })
        };
        let mut control = config.control.as_ref().map(bind).transpose()?;
        let mut bench = Self { handles: Vec::new(), tasks: JoinSet::new(), names: HashMap::new() };
        let mut reports = Vec::new();
        let mut tasks = Vec::new();
        for (plan, mut bus) in config.buses.iter().zip(buses) {
            bus.observe(options.trace);
            let devices = bus.stations().iter().map(|station| DeviceReport {
                name: station.name().into(),
                model: station.kind().name,
                unit: station.address().unit,
            });
            let devices = devices.collect();
            let mut watchers: Vec<Watcher> = options.trace.then(trace::watcher).into_iter().collect();
            watchers.extend(control.as_mut().map(|control| control.attach(&mut bus)));
            let (task, handle) = open(plan, bus, store.clone(), clock, watchers)?;
            reports.push(BusReport::new(&handle, plan.settings, devices));
            bench.handles.push(handle);
            tasks.push(task);
        }
        for (task, handle) in tasks.into_iter().zip(&bench.handles) {
            let id = bench.tasks.spawn(task.run()).id();
            bench.names.insert(id, handle.name.clone());
        }
        let url = control.as_ref().map(Server::url);
        if let Some(control) = control {
            let failed = |source| RunError::System { what: "the control interface cannot start", source };
            control.start(&bench.handles).map_err(failed)?;
        }
        let report = Report { ready: true, buses: reports, control: url };
        let text = if options.json { report.json() } else { report.text() };
        let mut out = io::stdout().lock();
        let told = out.write_all(text.as_bytes()).and_then(|()| out.flush());
        match told {
            Err(error) if options.exit_with_parent => {
                // Nobody reads it, so whoever started this has gone before its number could be asked for.
                Err(RunError::System { what: "the start report cannot be printed", source: error })
            }
            Err(error) => {
                warn!("the start report cannot be printed: {error}");
                Ok(bench)
            }
            Ok(()) => Ok(bench),
        }
    }

    /// Serves until the end is asked for or a bus fails, and ends in order.
    async fn serve(mut self, ends: &mut Ends) -> Result<(), RunError> {
        let mut failure = tokio::select! {
            () = ends.come() => None,
            ended = self.tasks.join_next_with_id() => ended.and_then(|ended| self.failure(ended)),
        };
        let ending = async {
            for handle in &self.handles {
                handle.stop().await;
            }
            while let Some(ended) = self.tasks.join_next_with_id().await {
                failure = failure.take().or(failure_of(&self.names, ended));
            }
        };
        let early = tokio::select! {
            () = ending => None,
            () = ends.signal() => Some("a second signal came"),
            () = tokio::time::sleep(END_WITHIN) => Some("it took too long"),
        };
        match (failure, early) {
            (Some(failure), _) => Err(failure),
            (None, Some(why)) => Err(RunError::Early { why }),
            (None, None) => Ok(()),
        }
    }

    fn failure(&self, ended: Ended) -> Option<RunError> {
        failure_of(&self.names, ended)
    }
}

type Ended = Result<(tokio::task::Id, io::Result<()>), JoinError>;

/// Why a bus' task has ended, where it was not told to.
fn failure_of(names: &HashMap<tokio::task::Id, String>, ended: Ended) -> Option<RunError> {
    let (id, reason) = match ended {
        Ok((_, Ok(()))) => return None,
        Ok((id, Err(error))) => (id, error.to_string()),
        Err(error) => (error.id(), error.to_string()),
    };
    Some(RunError::Bus { bus: names.get(&id).cloned().unwrap_or_default(), reason })
}

/// A station with the memory of its last run.
fn station(setup: &Setup, layout: Arc<Layout>, store: Option<&Store>, clock: &SimClock) -> Result<Station, RunError> {
    let saved = store.map(|store| store.images().load(setup)).transpose()?.flatten();
    Station::new(setup.clone(), layout, saved.as_ref(), clock).map_err(|problems| {
        let device = setup.name.clone();
        match store.filter(|_| saved.is_some()) {
            Some(store) => store.images().refused(&device, problems.join("; ")).into(),
            None => RunError::Device { device, problems },
        }
    })
}

/// Writes the images of all devices of a bus, so that a folder that takes none is found out before anything runs.
fn keep_first(bus: &mut Bus, store: &Store) -> Result<(), RunError> {
    bus.keep_memory();
    while let Some(output) = bus.poll(crate::time::Instant(0)) {
        match output {
            Output::Persist { station, saved } => store.write(bus.stations()[station].name(), &saved)?,
            Output::Note(note) => warn!("{}: {note}", bus.name()),
            Output::Transmit { .. } | Output::Exchange(_) | Output::Event(_) => {}
        }
    }
    Ok(())
}

fn open(
    plan: &BusConfig,
    bus: Bus,
    store: Option<Arc<Store>>,
    clock: RealClock,
    watchers: Vec<Watcher>,
) -> Result<(BusTask, BusHandle), RunError> {
    BusTask::new(bus, plan, store, clock, watchers).map_err(|(port, source)| match port {
        Some(port) => RunError::Port { bus: plan.name.clone(), port: port.to_string(), source },
        None => RunError::System { what: "a bus cannot start", source },
    })
}
