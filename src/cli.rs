//! The command line: what is asked for, and what is printed. `standin --help` shows it.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use chrono::{Local, NaiveDateTime};
use clap::{CommandFactory, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;

use crate::config::{Config, DEFAULT_FILE, EXAMPLE, Overrides};
use crate::device::Kind;
use crate::devices::{KINDS, kind};
use crate::export;

/// Exit status of a bad command line or configuration: nothing was started.
const BAD_CONFIGURATION: u8 = 2;

/// A stand-in for field devices: Modbus slaves that behave as their manuals say.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
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
    match cli.command {
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
