// Memory of a completion on a small machine: 640x480 pixels, 500 points, the weights "small", 4 threads. Further images, each
// freed before the next, need somewhat more because of fragmentation. With its default options, glibc soon keeps large freed blocks
// in the heaps of its threads: one run of fifty then needs about 150 MB, depending on which thread did what. So this program sets
// the option that the README advises.

#include "check.h"
#include <malloc.h>
#include <sys/resource.h>

enum { W = 640, H = 480, COUNT = 500, MOST_MEGABYTES = 120, MOST_OF_SEVERAL = 125 };

static uint8_t pixels[3 * W * H];
static double x[COUNT], y[COUNT];
static float z[COUNT], depth[W * H];

// Peak memory of this process so far.
static double megabytes(void) {
    struct rusage usage;
    CHECK(getrusage(RUSAGE_SELF, &usage) == 0);
    // Kilobytes on Linux.
    return 1.024e-3 * (double)usage.ru_maxrss;
}

int main(void) {
#ifdef M_MMAP_THRESHOLD
    CHECK(mallopt(M_MMAP_THRESHOLD, 1 << 20) == 1);
#endif
    uint64_t random = 5;
    for (int i = 0; i < COUNT; ++i) {
        x[i] = uniform(&random) * (W - 1);
        y[i] = uniform(&random) * (H - 1);
        z[i] = x[i] < W / 2.0 ? 2.0f : 3.0f;
    }
    lsdc_completer_options options;
    memset(&options, 0, sizeof options);
    options.struct_size = sizeof options;
    options.threads = 4;
    lsdc_completer *small;
    OK(lsdc_completer_create("small", &options, &small));
    for (uint64_t frame = 0; frame < 3; ++frame) {
        lsdc_scene *scene;
        lsdc_completion *completion;
        paint(pixels, W, H, frame);
        lsdc_image image = image_of(pixels, W, H);
        lsdc_points points = points_of(x, y, z, COUNT);
        OK(lsdc_scene_create(small, &image, NULL, &scene));
        OK(lsdc_completer_release(small));
        OK(lsdc_scene_complete(scene, &points, NULL, &completion));
        OK(lsdc_completion_depth(completion, W, H, depth, sizeof depth, 0));
        CHECK(depth[W * H / 2] > 1.0f && depth[W * H / 2] < 4.0f);
        OK(lsdc_completion_free(completion));
        OK(lsdc_scene_free(scene));
        double most = megabytes();
        printf("memory: %.1f MB at most after image %d\n", most, (int)frame + 1);
        CHECK(most <= (frame == 0 ? MOST_MEGABYTES : MOST_OF_SEVERAL));
    }
    OK(lsdc_completer_free(small));
    return EXIT_SUCCESS;
}
