//! The command line: what is asked for, and what is printed. `standin --help` shows it.

use std::io::{self, IsTerminal, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use chrono::{Local, NaiveDateTime};
use clap::{ArgAction, Args, CommandFactory, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use tracing_subscriber::EnvFilter;

use crate::config::{
    Config, ConfigError, DEFAULT_FILE, EXAMPLE, Overrides, Start, parse_address, parse_rate, parse_start,
};
use crate::ctl::{self, CtlArgs};
use crate::device::Kind;
use crate::devices::{KINDS, kind};
use crate::export;
use crate::io::RunOptions;
use crate::store::{Images, Store, StoreError};

/// Exit status of a bad command line or configuration: nothing was started.
const BAD_CONFIGURATION: u8 = 2;

/// A stand-in for field devices: Modbus slaves that behave as their manuals say.
#[derive(Debug, Parser)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    long_about = "A stand-in for field devices: Modbus slaves that behave as their manuals say.\n\n\
        Without a command it runs the buses of devices.toml, or the built-in example where there is none: four \
        devices on the virtual serial port /tmp/standin/line1. Open that port with your Modbus program at 9600 8N2.",
    after_long_help = "\
Examples:
  standin                                     run ./devices.toml, or the built-in example
  standin init > devices.toml                 get the example with comments, to change to your liking
  standin check                               say what devices.toml means, and everything that is wrong with it
  standin run bench.toml --state state        run another file, and keep the devices' EEPROM in the folder state
  standin --start 2014-10-31T15:00 --rate 60  begin at that time, a minute a second
  standin --trace -q                          show every frame, in hex and in words
  standin registers logiccon-trc              every register of a model: address, name, range, factory value
  standin registers hmi-volcano-ec --format json   the same for scripts

Paths, those in the file too, are relative to the folder that standin is started in.
Exit status: 0 fine, 1 something failed at run time, 2 a bad command line or configuration (nothing was started)."
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    run: RunArgs,
}

#[derive(Debug, Args)]
struct RunArgs {
    /// The configuration [default: devices.toml, and where there is none the built-in example].
    config: Option<PathBuf>,
    /// Folder of the EEPROM images, in place of the file's `state`.
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Where the simulated clock starts: a local date-time such as 2014-10-27T14:22:08, or host.
    #[arg(long, value_name = "DATE-TIME", value_parser = parse_start)]
    start: Option<Start>,
    /// Simulated seconds a second, 0 to 86400; 0 stands still.
    #[arg(long, value_name = "X", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Where the control interface listens, such as 127.0.0.1:8502.
    #[arg(long, value_name = "ADDR", value_parser = parse_address)]
    listen: Option<SocketAddr>,
    /// Print every frame, in hex and in words, on stderr.
    #[arg(long)]
    trace: bool,
    /// Print the start report as one line of JSON.
    #[arg(long)]
    json: bool,
    /// End when the process that started this one ends.
    #[arg(long)]
    exit_with_parent: bool,
    /// Log more; twice: everything. RUST_LOG overrules it.
    #[arg(short, long, action = ArgAction::Count, conflicts_with = "quiet")]
    verbose: u8,
    /// Log errors only.
    #[arg(short, long)]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the buses of a configuration until a signal ends it.
    Run(RunArgs),
    /// Ask a running program for something: time, inputs, faults, the journal.
    Ctl(CtlArgs),
    /// List, show or reset what devices keep in EEPROM.
    #[command(after_help = "\
Examples:
  standin memory list
  standin memory show yard
  standin memory reset yard --state state")]
    Memory {
        /// What to do.
        #[command(subcommand)]
        command: MemoryCommand,
        /// Folder of the EEPROM images, in place of the file's `state`.
        #[arg(long, value_name = "DIR", global = true)]
        state: Option<PathBuf>,
        /// The configuration that names the folder.
        #[arg(long, value_name = "CONFIG", default_value = DEFAULT_FILE, global = true)]
        config: PathBuf,
    },
    /// Read and judge a configuration, print the plan, start nothing.
    #[command(after_help = "Example:\n  standin check bench.toml && standin run bench.toml")]
    Check {
        /// The configuration.
        #[arg(default_value = DEFAULT_FILE)]
        config: PathBuf,
    },
    /// Print the register map of a model.
    #[command(after_help = "\
Examples:
  standin registers kael-astro-01 | grep holiday
  standin registers logiccon-trc --format json | jq '.registers[] | {name, address}'

Addresses are those on the wire. COUNTS is the value of one count: with 0.1 V the number 275 means 27.5 V. WRITE is what
a write may carry, MEMORY whether the device keeps it over a restart.")]
    Registers {
        /// The model, as `standin models` lists it.
        #[arg(value_parser = parse_model)]
        model: &'static Kind,
        /// How to print it.
        #[arg(long, value_enum, default_value_t = Format::Table)]
        format: Format,
    },
    /// List the models, one a line.
    Models,
    /// Print an example devices.toml with comments.
    #[command(after_help = "Example:\n  standin init > devices.toml")]
    Init,
    /// Print a completion script for a shell.
    #[command(after_help = "Example:\n  standin completions bash > ~/.local/share/bash-completion/completions/standin")]
    Completions {
        /// The shell.
        shell: Shell,
    },
}

#[derive(Debug, Subcommand)]
enum MemoryCommand {
    /// List the devices that have images, with model and unit.
    List,
    /// Print the image of a device.
    Show {
        /// The device.
        device: String,
    },
    /// Take the image of a device away: with the next start it is as from the factory.
    Reset {
        /// The device.
        device: String,
    },
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// Columns, one register a line.
    Table,
    /// Tables in the manual's layout.
    Markdown,
    /// Comma-separated, one register a line.
    Csv,
    /// Everything a script needs to read and write by name.
    Json,
}

fn parse_model(name: &str) -> Result<&'static Kind, String> {
    kind(name).ok_or_else(|| {
        let models: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
        format!("the models are {}", models.join(", "))
    })
}

/// Does what the command line of this process asks for, and gives the exit status.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    match cli.command.unwrap_or(Command::Run(cli.run)) {
        Command::Run(args) => run(args),
        Command::Memory { command, state, config } => memory(&command, state, &config),
        Command::Ctl(args) => match ctl::run(args) {
            Ok(text) => print(&text),
            Err(failed) => {
                complain(&failed.text());
                ExitCode::FAILURE
            }
        },
        Command::Check { config } => check(&config),
        Command::Registers { model, format } => print(&match format {
            Format::Table => export::table(model),
            Format::Markdown => export::markdown(model),
            Format::Csv => export::csv(model),
            Format::Json => export::json(model),
        }),
        Command::Models => print(&KINDS.iter().map(|kind| format!("{}\n", kind.name)).collect::<String>()),
        Command::Init => print(EXAMPLE),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "standin", &mut script);
            print(&String::from_utf8_lossy(&script))
        }
    }
}

/// Prints to stdout; a reader that has seen enough is no failure.
fn print(text: &str) -> ExitCode {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            complain(&format!("stdout cannot be written: {error}"));
            ExitCode::FAILURE
        }
        _ => ExitCode::SUCCESS,
    }
}

/// Says what is wrong on stderr; where nobody can hear it, that is that.
fn complain(text: &str) {
    let _ = writeln!(io::stderr(), "{text}");
}

fn host_time() -> NaiveDateTime {
    Local::now().naive_local()
}

fn run(args: RunArgs) -> ExitCode {
    log(args.verbose, args.quiet);
    let overrides = Overrides { state: args.state, start: args.start, rate: args.rate, listen: args.listen };
    let config = match read(args.config.as_deref(), &overrides) {
        Ok(config) => config,
        Err(error) => {
            let hint = args.config.as_deref().map_or(String::new(), mistaken_command);
            complain(&format!("{error}{hint}"));
            return ExitCode::from(BAD_CONFIGURATION);
        }
    };
    config.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    let RunArgs { trace, json, exit_with_parent, .. } = args;
    match crate::io::run(config, RunOptions { trace, json, exit_with_parent }) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&format!("error: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// The configuration that is named, else the one that lies here, else the example.
fn read(path: Option<&Path>, overrides: &Overrides) -> Result<Config, ConfigError> {
    match path {
        Some(path) => Config::read(path, overrides, host_time()),
        None if Path::new(DEFAULT_FILE).exists() => Config::read(Path::new(DEFAULT_FILE), overrides, host_time()),
        None => Config::parse("the built-in example", EXAMPLE.as_bytes(), overrides, host_time()),
    }
}

/// A misspelt command is taken for a file: the hint says so where it looks like one.
fn mistaken_command(path: &Path) -> String {
    let word = path.to_string_lossy();
    let commands = Cli::command();
    let mut names = commands.get_subcommands().map(clap::Command::get_name);
    match names.find(|name| strsim::damerau_levenshtein(name, &word) <= 2) {
        Some(name) if !path.exists() => format!("\nDid you mean `standin {name}`?"),
        _ => String::new(),
    }
}

/// Logs go to stderr; `RUST_LOG` overrules the options.
fn log(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (false, 0) => "info",
        (false, 1) => "debug",
        (false, _) => "trace",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let is_terminal = io::stderr().is_terminal();
    // A program that has set up its own log before keeps it.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_ansi(is_terminal)
        .with_target(false)
        .try_init();
}

fn memory(command: &MemoryCommand, state: Option<PathBuf>, config: &Path) -> ExitCode {
    let folder = match state.map_or_else(|| state_of(config), Ok) {
        Ok(folder) => folder,
        Err(error) => {
            complain(&error);
            return ExitCode::from(BAD_CONFIGURATION);
        }
    };
    match memory_in(&folder, command) {
        Ok(text) => print(&text),
        Err(error) => {
            complain(&format!("error: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// The state folder that a configuration names.
fn state_of(config: &Path) -> Result<PathBuf, String> {
    let read = Config::read(config, &Overrides::default(), host_time());
    let state = read.map_err(|error| format!("{error}\nThe folder can be given with --state DIR too."))?.state;
    state.ok_or_else(|| format!("{} names no `state` folder: give one with --state DIR", config.display()))
}

fn memory_in(folder: &Path, command: &MemoryCommand) -> Result<String, StoreError> {
    let images = Images::at(folder);
    match command {
        MemoryCommand::List => {
            let mut text = String::new();
            for device in images.list()? {
                text += &match images.show(&device) {
                    Ok(saved) => format!("{device}: {}, unit {}\n", saved.model, saved.configured_unit),
                    Err(error) => format!("{device}: {error}\n"),
                };
            }
            Ok(text)
        }
        MemoryCommand::Show { device } => Ok(images.show(device)?.text()),
        MemoryCommand::Reset { device } => {
            // A folder that does not exist is not made for this.
            images.list()?;
            Store::open(folder)?.reset(device)?;
            Ok(format!("{device} is as from the factory when it starts next\n"))
        }
    }
}

fn check(path: &Path) -> ExitCode {
    match Config::read(path, &Overrides::default(), host_time()) {
        Ok(config) => {
            config.warnings.iter().for_each(|warning| complain(&format!("warning: {warning}")));
            print(&format!("{} is fine\n\n{}", path.display(), config.plan()))
        }
        Err(error) => {
            complain(&error.to_string());
            ExitCode::from(BAD_CONFIGURATION)
        }
    }
}
