//! The program `standin`: see [`standin::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    standin::cli::main()
}
