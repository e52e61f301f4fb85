//! The command line of `standin`.

fn main() {}
