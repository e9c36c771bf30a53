use lsdc::*;
use std::sync::atomic::AtomicBool;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let text = std::fs::read_to_string(&a[1]).unwrap();
    let config: train::TrainConfig = toml::from_str(&text).unwrap();
    let folder = std::path::Path::new(&a[2]);
    std::fs::create_dir_all(folder).unwrap();
    let net = if a[3] == "small" { model::BasisNetConfig::small() } else { model::BasisNetConfig::paper() };
    let fit = fit::FitConfig { ridge: a[4].parse().unwrap(), ..Default::default() };
    let mut dc = data::DataConfig::default();
    if a[5] != "rooms" { dc.dataset = data::DatasetKind::Nyu; dc.root = Some(a[5].clone().into()); }
    let frames = dc.open(data::Split::Train, None).unwrap();
    let device = burn::tensor::Device::flex();
    println!("params {}", model::parameter_count(&net.init(0, &device).unwrap()));
    let t = train::Trainer::new(folder, net, fit, config, frames, &device).unwrap();
    let out = t.run(&AtomicBool::new(false), |e| println!("{e:?}"));
    println!("{out:?}");
}
