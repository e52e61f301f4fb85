//! Writes the seeds of all targets to `corpus/`, where cargo-fuzz looks for them.

#[path = "../tests/bench/mod.rs"]
mod bench;
#[allow(dead_code)]
mod bodies;

fn main() -> std::io::Result<()> {
    let fuzz = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    for (target, name, bytes) in bodies::seeds(&fuzz.join("..")) {
        let folder = fuzz.join("corpus").join(target);
        std::fs::create_dir_all(&folder)?;
        std::fs::write(folder.join(format!("seed-{name}")), bytes)?;
    }
    Ok(())
}
