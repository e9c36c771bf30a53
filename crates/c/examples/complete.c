// Completes depth from an image and sparse depths, with error estimates.
//
//     complete IMAGE.ppm SPARSE.npy DEPTH.npy [DEVIATION.npy]

#include "files.h"
#include <lsdc.h>

static void check(lsdc_status status) {
    if (status == LSDC_OK) return;
    fprintf(stderr, "lsdc: %s\n", lsdc_last_error());
    if (*lsdc_last_hint()) fprintf(stderr, "hint: %s\n", lsdc_last_hint());
    exit(EXIT_FAILURE);
}

int main(int count, char **arguments) {
    if (count < 4) {
        fprintf(stderr, "usage: %s IMAGE.ppm SPARSE.npy DEPTH.npy [DEVIATION.npy]\n", arguments[0]);
        return EXIT_FAILURE;
    }
    size_t width, height;
    uint8_t *rgb = read_ppm(arguments[1], &width, &height);
    float *sparse = read_npy(arguments[2], width, height);
    size_t bytes = width * height * sizeof(float);

    lsdc_completer *completer;
    check(lsdc_completer_create("default", NULL, &completer));

    lsdc_image image = {
        .struct_size = sizeof image,
        .data = rgb,
        .size = 3 * width * height,
        .width = width,
        .height = height,
        .format = LSDC_RGB8,
    };
    lsdc_scene *scene;
    check(lsdc_scene_create(completer, &image, NULL, &scene));
    // No other image follows: free the memory of the network before the fit allocates.
    check(lsdc_completer_release(completer));

    lsdc_map map = {
        .struct_size = sizeof map,
        .data = sparse,
        .size = bytes,
        .width = width,
        .height = height,
        .format = LSDC_F32,
    };
    lsdc_completion *completion;
    check(lsdc_scene_complete_map(scene, &map, NULL, NULL, &completion));

    float *depth = (float *)allocated(arguments[3], bytes);
    check(lsdc_completion_depth(completion, width, height, depth, bytes, 0));
    write_npy(arguments[3], depth, width, height);
    if (count > 4) {
        check(lsdc_completion_standard_deviation(completion, width, height, depth, bytes, 0));
        write_npy(arguments[4], depth, width, height);
    }

    lsdc_report report = {.struct_size = sizeof report};
    double between;
    size_t outliers;
    check(lsdc_completion_report(completion, &report));
    check(lsdc_completion_leave_one_out_error(completion, &between));
    check(lsdc_completion_outliers(completion, NULL, 0, sizeof(lsdc_outlier), &outliers));
    printf("%zu of %zu points, %.3f m off at the points, %.3f m between them, %zu outliers\n",
           report.used, report.given, report.residual, between, outliers);

    lsdc_completion_free(completion);
    lsdc_scene_free(scene);
    lsdc_completer_free(completer);
    free(depth);
    free(sparse);
    free(rgb);
    return EXIT_SUCCESS;
}
