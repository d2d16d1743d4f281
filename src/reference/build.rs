//! Finds Ipopt for the feature `ipopt`; does nothing without it.

fn main() {
    println!("cargo::rerun-if-changed=src/reference/build.rs");
    #[cfg(feature = "ipopt")]
    ipopt();
}

#[cfg(feature = "ipopt")]
fn ipopt() {
    // The C interface has not changed since 3.9.
    match pkg_config::Config::new().atleast_version("3.9").cargo_metadata(false).probe("ipopt") {
        Ok(library) => {
            println!("cargo::rustc-env=IPOPT_VERSION={}", library.version);
            for path in library.link_paths {
                println!("cargo::rustc-link-search=native={}", path.display());
            }
            // Only the library itself: the shared library knows its LAPACK and MUMPS, whose development files need not be installed.
            println!("cargo::rustc-link-lib=ipopt");
        }
        Err(_) => {
            println!("cargo::error=the feature `ipopt` links Ipopt (3.9 or newer), and pkg-config does not find it");
            println!("cargo::error=Debian, Ubuntu: apt-get install coinor-libipopt-dev pkg-config");
            println!(
                "cargo::error=elsewhere: install Ipopt (https://coin-or.github.io/Ipopt) and put the folder of its ipopt.pc on PKG_CONFIG_PATH"
            );
            println!("cargo::error=or build without the feature: the program needs Ipopt for comparisons only");
        }
    }
}
