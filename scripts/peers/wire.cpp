// A link between two network namespaces that delays and drops frames, for kernels without netem.
//
//     ip netns add a; ip netns add b
//     wire a 10.77.0.1/24 b 10.77.0.2/24 DELAY_MS LOSS_PERCENT
//
// Each namespace gets a TAP interface, `wire0`. Ethernet frames with at most 1500 bytes of IP pass in order after the delay; a
// share of the frames in either direction is lost at random (seed 1). Ends when standard input ends.

#include <fcntl.h>
#include <linux/if.h>
#include <linux/if_tun.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <random>
#include <string>
#include <vector>

using Clock = std::chrono::steady_clock;

struct Frame {
  Clock::time_point due;
  std::vector<char> bytes;
};

static int open_tap(const std::string& name, const std::string& space, const std::string& address) {
  int fd = open("/dev/net/tun", O_RDWR | O_NONBLOCK);
  ifreq request{};
  request.ifr_flags = IFF_TAP | IFF_NO_PI;
  std::strncpy(request.ifr_name, name.c_str(), IFNAMSIZ - 1);
  if (fd < 0 || ioctl(fd, TUNSETIFF, &request) < 0) {
    std::perror("wire");
    std::exit(1);
  }
  const std::string in = "ip -n " + space;
  const std::string setup = "ip link set " + name + " netns " + space + " && " + in + " link set " + name + " name wire0 && " +
                            in + " addr add " + address + " dev wire0 && " + in + " link set lo up && " + in +
                            " link set wire0 up && " + in + " route add default dev wire0";
  if (std::system(setup.c_str()) != 0) std::exit(1);
  return fd;
}

int main(int count, char** arguments) {
  if (count != 7) return 2;
  const int ends[2] = {open_tap("wire-a", arguments[1], arguments[2]), open_tap("wire-b", arguments[3], arguments[4])};
  const auto delay = std::chrono::microseconds(static_cast<long>(1000 * std::atof(arguments[5])));
  std::mt19937 random(1);
  std::bernoulli_distribution lost(std::atof(arguments[6]) / 100);
  std::deque<Frame> under_way[2];
  unsigned long passed = 0, dropped = 0;
  std::puts("ready");
  std::fflush(stdout);
  while (true) {
    int wait = 1000;
    for (int from = 0; from < 2; from++) {
      auto& frames = under_way[from];
      while (!frames.empty() && frames.front().due <= Clock::now()) {
        const auto& bytes = frames.front().bytes;
        if (write(ends[1 - from], bytes.data(), bytes.size()) > 0) passed++;
        frames.pop_front();
      }
      if (!frames.empty()) wait = 1;
    }
    pollfd polled[3] = {{ends[0], POLLIN, 0}, {ends[1], POLLIN, 0}, {0, POLLIN, 0}};
    poll(polled, 3, wait);
    char buffer[2048];
    if (polled[2].revents != 0 && read(0, buffer, sizeof buffer) <= 0) break;
    for (int from = 0; from < 2; from++) {
      ssize_t length;
      while ((length = read(ends[from], buffer, sizeof buffer)) > 0) {
        if (lost(random)) {
          dropped++;
        } else {
          under_way[from].push_back({Clock::now() + delay, {buffer, buffer + length}});
        }
      }
    }
  }
  std::printf("%lu frames passed, %lu lost\n", passed, dropped);
}
