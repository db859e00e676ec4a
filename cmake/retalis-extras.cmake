# Test cases of a program as tests of a package of ROS 1, whose results catkin_test_results lists.

# Adds a test target for test cases of a program.
#
# :param path: a test file, or a folder with such files, relative to the current source folder
# :param ARGS: further arguments of `retalis test`
function(catkin_add_retalis_test path)
  cmake_parse_arguments(retalis_test "" "" "ARGS" ${ARGN})
  get_filename_component(cases ${path} ABSOLUTE)
  if(NOT EXISTS ${cases})
    message(FATAL_ERROR "catkin_add_retalis_test: there is no file or folder '${cases}'")
  endif()
  string(REGEX REPLACE "[^A-Za-z0-9_]" "_" name ${path})
  set(results ${CATKIN_TEST_RESULTS_DIR}/${PROJECT_NAME}/retalis-${name}.xml)
  string(REPLACE ";" " " arguments "${retalis_test_ARGS}")
  catkin_run_tests_target(
    retalis ${name} retalis-${name}.xml
    COMMAND "retalis test ${cases} --junit ${results} ${arguments}"
  )
endfunction()
